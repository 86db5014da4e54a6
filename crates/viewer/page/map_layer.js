// Landmarks as points, keyframes as frusta with covariance ellipsoids, lines between places that look alike.
import * as THREE from "three";
import { rampColor, styleColor, theme } from "./colors.js";

// Corners of a frustum of size 1 in the camera's frame: x right, y down, z forward.
const CORNERS = [[-0.5, -0.35, 0.6], [0.5, -0.35, 0.6], [0.5, 0.35, 0.6], [-0.5, 0.35, 0.6]];
const EDGES = [[4, 0], [4, 1], [4, 2], [4, 3], [0, 1], [1, 2], [2, 3], [3, 0]];

// An image of a keyframe is not taken for another place whose log-odds are below this.
const CERTAINLY_OTHER = -1;

export function pose(rotation, position) {
  const [w, x, y, z] = rotation;
  return new THREE.Matrix4().compose(
    new THREE.Vector3(...position), new THREE.Quaternion(x, y, z, w), new THREE.Vector3(1, 1, 1));
}

// Turns the unit sphere into the ellipsoid of three standard deviations: three times the Cholesky factor.
export function ellipsoid(covariance, position) {
  const [[a, b, c], [, d, e], [, , f]] = covariance;
  const root = (value) => Math.sqrt(Math.max(value, 1e-12));
  const l00 = root(a);
  const [l10, l20] = [b / l00, c / l00];
  const l11 = root(d - l10 * l10);
  const l21 = (e - l20 * l10) / l11;
  const l22 = root(f - l20 * l20 - l21 * l21);
  const [x, y, z] = position;
  return new THREE.Matrix4().set(
    3 * l00, 0, 0, x, 3 * l10, 3 * l11, 0, y, 3 * l20, 3 * l21, 3 * l22, z, 0, 0, 0, 1);
}

export class MapLayer {
  constructor(scene) {
    this.scene = scene;
    this.group = new THREE.Group();
    scene.world.add(this.group);
    this.layers = {};
    this.keyframes = new Map();
    this.visible = {};
  }

  clear() {
    for (const part of Object.values(this.layers)) {
      this.group.remove(part);
      part.geometry.dispose();
      part.material.dispose();
    }
    this.layers = {};
    this.keyframes.clear();
  }

  set(keyframes, landmarks, up) {
    this.clear();
    for (const keyframe of keyframes) this.keyframes.set(keyframe.id, keyframe);
    this.layers.landmarks = this.points(landmarks, new THREE.Vector3(...up));
    this.layers.keyframes = this.frusta(keyframes);
    this.layers.ellipsoids = this.ellipsoids(keyframes);
    this.layers.aliases = this.aliases(keyframes);
    this.group.add(...Object.values(this.layers));
    for (const [name, visible] of Object.entries(this.visible)) this.show(name, visible);
    this.applyTheme();
  }

  show(name, visible) {
    this.visible[name] = visible;
    if (this.layers[name]) this.layers[name].visible = visible;
  }

  applyTheme() {
    // On white, darker.
    this.layers.landmarks?.material.color.setScalar(theme() === "light" ? 0.55 : 1);
    this.layers.keyframes?.material.color.set(styleColor("--keyframe"));
    this.layers.ellipsoids?.material.color.set(styleColor("--accent"));
    this.layers.aliases?.material.color.set(styleColor("--ambiguous"));
  }

  points(positions, up) {
    const count = positions.length / 3;
    const heights = new Float32Array(count);
    for (let at = 0; at < count; at += 1) {
      heights[at] = positions[3 * at] * up.x + positions[3 * at + 1] * up.y + positions[3 * at + 2] * up.z;
    }
    // Without the few that are far off.
    const sorted = heights.slice().sort();
    const [low, high] = [sorted[Math.floor(count * 0.05)] ?? 0, sorted[Math.floor(count * 0.95)] ?? 1];
    const colors = new Float32Array(positions.length);
    heights.forEach((height, at) => rampColor((height - low) / Math.max(high - low, 0.1), colors, 3 * at));
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(colors, 3));
    const material = new THREE.PointsMaterial({
      size: 2.2, sizeAttenuation: false, vertexColors: true, transparent: true, opacity: 0.75, depthWrite: false,
    });
    return new THREE.Points(geometry, material);
  }

  frusta(keyframes) {
    this.size = frustumSize(keyframes);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(frustumEnds(keyframes, this.size), 3));
    return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial());
  }

  // Keyframes that could be taken for another place, each with a line to it.
  aliases(keyframes) {
    const aliased = keyframes.filter((keyframe) => keyframe.alias?.log_odds > CERTAINLY_OTHER);
    const lines = aliased.flatMap((keyframe) => {
      const other = this.keyframes.get(keyframe.alias.keyframe);
      return other ? [...keyframe.position, ...other.position] : [];
    });
    const ends = new Float32Array([...frustumEnds(aliased, 1.15 * this.size), ...lines]);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(ends, 3));
    return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ transparent: true, opacity: 0.6 }));
  }

  ellipsoids(keyframes) {
    const material = new THREE.MeshLambertMaterial({ transparent: true, opacity: 0.35, depthWrite: false });
    const ball = keyframes.length > 2000 ? new THREE.SphereGeometry(1, 8, 6) : new THREE.SphereGeometry(1, 16, 10);
    const mesh = new THREE.InstancedMesh(ball, material, keyframes.length);
    keyframes.forEach((keyframe, at) => mesh.setMatrixAt(at, ellipsoid(keyframe.position_covariance, keyframe.position)));
    return mesh;
  }
}

// The ends of the edges of frusta, in G.
export function frustumEnds(keyframes, size) {
  const ends = new Float32Array(keyframes.length * EDGES.length * 6);
  let at = 0;
  for (const { rotation_wxyz: rotation, position } of keyframes) {
    const place = pose(rotation, position);
    const corners = [...CORNERS, [0, 0, 0]].map(([x, y, z]) =>
      new THREE.Vector3(x * size, y * size, z * size).applyMatrix4(place));
    for (const end of EDGES.flat()) {
      corners[end].toArray(ends, at);
      at += 3;
    }
  }
  return ends;
}

// A third of the usual distance between neighbours, within what is seen.
function frustumSize(keyframes) {
  const steps = [];
  for (let at = 1; at < keyframes.length; at += 1) {
    const [a, b] = [keyframes[at - 1].position, keyframes[at].position];
    steps.push(Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]));
  }
  steps.sort((a, b) => a - b);
  return Math.min(Math.max((steps[steps.length >> 1] ?? 1) * 0.5, 0.08), 0.8);
}
