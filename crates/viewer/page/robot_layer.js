// Robots: body, name, covariance, trail, odometry and the keyframes of the last answer.
import * as THREE from "three";
import { ellipsoid, pose } from "./map_layer.js";
import { robotColor, styleColor } from "./colors.js";
import { colorNumber } from "./names.js";

const TRAIL_POINTS = 20000;
const FIRST_TRAIL_POINTS = 256;
const MIN_STEP_M = 0.01;
const RAYS_MS = 1500;
const BODY_PX = 22;

// Of robots that nobody has heard of, their colour says so.
const NOT_THERE = { silent: "--odometry-only", unreachable: "--faint", unknown: "--faint", off: "--faint" };

// Shared by all robots. A flat arrow along the x axis of the body, and what becomes an ellipsoid.
const ARROW = new THREE.ExtrudeGeometry(
  new THREE.Shape([[0.6, 0], [-0.4, 0.38], [-0.2, 0], [-0.4, -0.38]].map(([x, y]) => new THREE.Vector2(x, y))),
  { depth: 0.12, bevelEnabled: false });
const BALL = new THREE.SphereGeometry(1, 24, 16);

// A line that grows; when it is full, every second of its older points is left out.
class Track {
  constructor(parent, material) {
    this.count = 0;
    this.every = 1;
    this.line = new THREE.Line(new THREE.BufferGeometry(), material);
    this.line.frustumCulled = false;
    this.positions = new Float32Array(0);
    this.reserve(FIRST_TRAIL_POINTS);
    parent.add(this.line);
  }

  // Makes room for points; a buffer of the graphics card does not grow, so that there is a new one.
  reserve(points) {
    if (3 * points <= this.positions.length) return;
    const positions = new Float32Array(3 * Math.min(Math.max(points, 2 * this.count), TRAIL_POINTS));
    positions.set(this.positions);
    this.positions = positions;
    this.line.geometry.dispose();
    this.line.geometry = new THREE.BufferGeometry();
    this.line.geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    this.line.geometry.setDrawRange(0, this.count);
  }

  add(position) {
    const last = 3 * (this.count - 1);
    if (this.count > 0) {
      const step = Math.hypot(...position.map((value, axis) => value - this.positions[last + axis]));
      if (step < MIN_STEP_M) return;
    }
    if (this.count === TRAIL_POINTS) this.thin();
    this.reserve(this.count + 1);
    this.positions.set(position, 3 * this.count);
    this.count += 1;
    this.line.geometry.attributes.position.addUpdateRange(3 * (this.count - 1), 3);
    this.update();
  }

  set(positions) {
    this.every = Math.max(1, Math.ceil(positions.length / TRAIL_POINTS));
    this.count = 0;
    this.reserve(Math.ceil(positions.length / this.every));
    this.line.geometry.attributes.position.clearUpdateRanges();
    for (let at = 0; at < positions.length; at += this.every) {
      this.positions.set(positions[at], 3 * this.count);
      this.count += 1;
    }
    this.update();
  }

  // Draws the first points only.
  reveal(count) {
    this.line.geometry.setDrawRange(0, Math.min(Math.ceil(count / this.every), this.count));
  }

  thin() {
    for (let at = 0; at < TRAIL_POINTS / 2; at += 1) {
      this.positions.copyWithin(3 * at, 6 * at, 6 * at + 3);
    }
    this.count = TRAIL_POINTS / 2;
    this.line.geometry.attributes.position.clearUpdateRanges();
    this.line.geometry.attributes.position.addUpdateRange(0, 3 * this.count);
  }

  update() {
    const geometry = this.line.geometry;
    geometry.attributes.position.needsUpdate = true;
    geometry.setDrawRange(0, this.count);
    if (this.line.isLine && this.line.material.isLineDashedMaterial) this.line.computeLineDistances();
  }
}

export class Robot {
  constructor(scene, name, visible) {
    this.scene = scene;
    this.name = name;
    this.state = null;
    this.position = null;
    this.localAnchor = null;
    this.group = new THREE.Group();
    scene.world.add(this.group);

    this.body = new THREE.Mesh(ARROW, new THREE.MeshLambertMaterial({ transparent: true }));
    this.body.visible = false;
    this.body.matrixAutoUpdate = false;
    const shell = new THREE.MeshLambertMaterial({ transparent: true, opacity: 0.3, depthWrite: false });
    this.cloud = new THREE.Mesh(BALL, shell);
    this.cloud.matrixAutoUpdate = false;
    this.cloud.visible = false;
    this.group.add(this.body, this.cloud);
    this.trail = new Track(this.group, new THREE.LineBasicMaterial());
    this.odometry = new Track(this.group, new THREE.LineDashedMaterial({ dashSize: 0.25, gapSize: 0.18 }));
    this.rays = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ transparent: true }));
    this.rays.frustumCulled = false;
    this.group.add(this.rays);
    this.raysUntil = 0;
    this.isPast = false;
    this.isLabelled = true;

    this.label = document.createElement("div");
    this.label.className = "label";
    this.label.textContent = name;
    this.label.hidden = true;
    document.getElementById("labels").append(this.label);
    this.visible = visible;
    this.applyTheme();
  }

  applyTheme() {
    const color = this.state in NOT_THERE ? styleColor(NOT_THERE[this.state]) : robotColor(colorNumber(this.name));
    for (const part of [this.body, this.cloud, this.trail.line, this.odometry.line]) part.material.color.set(color);
    this.rays.material.color.set(styleColor("--text"));
    this.label.style.setProperty("--robot", color);
  }

  setPose(globalFromImu, isTrailed = true) {
    this.position = globalFromImu.position;
    this.placed = pose(globalFromImu.rotation_wxyz, globalFromImu.position);
    this.cloud.matrix.copy(ellipsoid(globalFromImu.position_covariance, globalFromImu.position));
    this.cloud.matrixWorldNeedsUpdate = true;
    if (isTrailed) this.trail.add(this.position);
  }

  // A sign of the state before the name; an old pose is pale.
  setState(state, sign, isOld) {
    if (this.state !== state) {
      this.state = state;
      this.label.textContent = `${sign} ${this.name}`;
      this.applyTheme();
    }
    this.label.classList.toggle("is-old", isOld);
    this.body.material.opacity = isOld ? 0.4 : 1;
  }

  // A new process has another odometry frame.
  restartOdometry() {
    this.localAnchor = null;
    this.odometry.set([]);
  }

  // What was drawn is in the frame of another map.
  leaveMap() {
    this.position = null;
    this.trail.set([]);
    this.restartOdometry();
    this.raysUntil = 0;
  }

  // The odometry in the map's frame, by the first transform that was known: what the map has corrected since, it lacks.
  setOdometry(position, globalFromLocal) {
    if (!this.localAnchor && globalFromLocal) {
      this.localAnchor = pose(globalFromLocal.rotation_wxyz, globalFromLocal.position);
    }
    if (this.localAnchor) {
      this.odometry.add(new THREE.Vector3(...position).applyMatrix4(this.localAnchor).toArray());
    }
  }

  setAnswer(keyframes, now) {
    if (!this.position) return;
    const ends = keyframes.flatMap((keyframe) => [...this.position, ...keyframe.position]);
    this.rays.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(ends), 3));
    this.raysUntil = now + RAYS_MS;
  }

  // Shows a trail of the past, of which `setPast` reveals as much as a time has.
  showPast(trail) {
    this.isPast = true;
    this.trail.set(trail);
  }

  // `pose`: null where it had none.
  setPast(pose, trailCount) {
    if (pose) this.setPose(pose, false);
    else this.position = null;
    this.trail.reveal(trailCount);
  }

  showPresent(trail) {
    this.isPast = false;
    this.past = null;
    this.trail.set(trail);
  }

  // Where its x axis points: degrees from the map's x axis, counterclockwise seen from above; null where it is not known.
  heading(up) {
    if (!this.position) return null;
    const forward = new THREE.Vector3().setFromMatrixColumn(this.placed, 0);
    const reference = new THREE.Vector3(...(Math.abs(up.x) < 0.9 ? [1, 0, 0] : [0, 1, 0])).projectOnPlane(up).normalize();
    const aside = new THREE.Vector3().crossVectors(up, reference);
    const degrees = (Math.atan2(forward.dot(aside), forward.dot(reference)) * 180) / Math.PI;
    return Math.round(degrees + 360) % 360;
  }

  worldPosition() {
    return this.position && this.scene.world.localToWorld(new THREE.Vector3(...this.position));
  }

  // Before each picture.
  draw(now) {
    const { ellipsoids, trails, odometry, rays } = this.visible;
    const place = this.worldPosition();
    this.body.visible = Boolean(place);
    this.cloud.visible = Boolean(place) && ellipsoids;
    this.trail.line.visible = trails;
    this.odometry.line.visible = odometry && !this.isPast;
    const left = (this.raysUntil - now) / RAYS_MS;
    this.rays.visible = rays && left > 0 && !this.isPast;
    this.rays.material.opacity = Math.max(left, 0) * 0.8;
    this.label.hidden = !place;
    if (!place) return;
    const size = Math.max(0.5, BODY_PX * this.scene.metresPerPixel(place));
    this.body.matrix.copy(this.placed).scale(new THREE.Vector3(size, size, size));
    this.body.matrixWorldNeedsUpdate = true;
    const seen = place.project(this.scene.camera);
    this.label.hidden = seen.z > 1 || !this.isLabelled;
    const [x, y] = [((seen.x + 1) / 2) * window.innerWidth, ((1 - seen.y) / 2) * window.innerHeight];
    this.label.style.transform = `translate(${x + 16}px, ${y - 28}px)`;
  }
}
