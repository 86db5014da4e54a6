// Renderer, camera and the world: everything below `world` has the coordinates of the map's frame G, metres.
import * as THREE from "three";
import { OrbitControls } from "./vendor/OrbitControls.js";
import { styleColor } from "./colors.js";

const UP = new THREE.Vector3(0, 1, 0);
const PANELS = ["about", "tools", "side", "legend", "replay"];

// The largest rectangle of the page, pixels, that no panel covers. Its edges are those of panels or of the page.
function freeArea(width, height) {
  const panels = PANELS.map((id) => document.getElementById(id).getBoundingClientRect()).filter((panel) => panel.width > 0);
  const edges = (all, end) => [...new Set([0, end, ...all])].filter((edge) => edge >= 0 && edge <= end).sort((a, b) => a - b);
  const across = edges(panels.flatMap(({ left, right }) => [left, right]), width);
  const down = edges(panels.flatMap(({ top, bottom }) => [top, bottom]), height);
  let free = { left: 0, right: width, top: 0, bottom: height };
  let largest = 0;
  for (const left of across) {
    for (const right of across.filter((edge) => edge > left)) {
      const within = panels.filter((panel) => panel.left < right && panel.right > left);
      for (const top of down) {
        const bottom = Math.min(height, ...within.filter((panel) => panel.bottom > top).map((panel) => Math.max(panel.top, top)));
        const area = (right - left) * (bottom - top);
        if (area > largest) [largest, free] = [area, { left, right, top, bottom }];
      }
    }
  }
  return free;
}

// The horizontal direction in which points spread the most.
function longestHorizontal(points, centre) {
  let [xx, xz, zz] = [0, 0, 0];
  for (const point of points) {
    const [x, z] = [point.x - centre.x, point.z - centre.z];
    xx += x * x;
    xz += x * z;
    zz += z * z;
  }
  const angle = Math.atan2(2 * xz, xx - zz) / 2;
  return new THREE.Vector3(Math.cos(angle), 0, Math.sin(angle));
}

export class Scene {
  constructor(canvas) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(50, 1, 0.05, 20000);
    this.camera.position.set(8, 8, 8);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = true;
    this.controls.dampingFactor = 0.15;
    this.controls.maxPolarAngle = Math.PI;
    this.world = new THREE.Group();
    this.scene.add(this.world);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x777777, 2.5));
    const sun = new THREE.DirectionalLight(0xffffff, 1.2);
    sun.position.set(0.4, 1, 0.7);
    this.scene.add(sun);
    this.box = new THREE.Box3();
    this.points = [];
    this.up = new THREE.Vector3(0, 0, 1);
    this.along = new THREE.Vector3(1, 0, 0);
    this.grid = null;
    this.resize();
    window.addEventListener("resize", () => this.resize());
    // Lists grow, and differ in how much of the map they cover.
    new ResizeObserver(() => this.centre()).observe(document.getElementById("side"));
    this.applyTheme();
  }

  resize() {
    const [width, height] = [window.innerWidth, window.innerHeight];
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.centre();
  }

  // Makes the middle of what panels leave the middle of the picture.
  centre() {
    const [width, height] = [window.innerWidth, window.innerHeight];
    this.free = freeArea(width, height);
    const { left, right, top, bottom } = this.free;
    this.camera.setViewOffset(width, height, (width - left - right) / 2, (height - top - bottom) / 2, width, height);
  }

  applyTheme() {
    this.scene.background = new THREE.Color(styleColor("--background"));
    this.setGrid();
  }

  // `up`: upwards in G.
  setUp(up) {
    this.up = new THREE.Vector3(...up).normalize();
    this.world.quaternion.setFromUnitVectors(new THREE.Vector3(...up).normalize(), UP);
    this.world.updateMatrixWorld(true);
  }

  // Makes the view hold points of G.
  setPoints(points) {
    this.points = points.map((point) => this.world.localToWorld(new THREE.Vector3(...point)));
    if (this.points.length === 0) this.points = [new THREE.Vector3(-5, -1, -5), new THREE.Vector3(5, 1, 5)];
    this.box.setFromPoints(this.points);
    this.along = longestHorizontal(this.points, this.box.getCenter(new THREE.Vector3()));
    this.setGrid();
  }

  setGrid() {
    if (this.grid) {
      this.scene.remove(this.grid);
      this.grid.geometry.dispose();
      this.grid.material.dispose();
    }
    if (this.box.isEmpty()) return;
    const size = this.box.getSize(new THREE.Vector3());
    const span = Math.max(size.x, size.z, 4) * 1.3;
    this.step = 10 ** Math.floor(Math.log10(span / 4));
    if (span / this.step > 20) this.step *= 5;
    const cells = Math.ceil(span / this.step);
    const color = new THREE.Color(styleColor("--grid"));
    this.grid = new THREE.GridHelper(cells * this.step, cells, color, color);
    const centre = this.box.getCenter(new THREE.Vector3());
    this.grid.position.set(centre.x, this.box.min.y, centre.z);
    this.scene.add(this.grid);
    document.getElementById("grid-size").textContent = `Grid: ${this.step} m. Positions in metres, in the map's frame.`;
  }

  // Looks at all points from a direction: how far upwards, sideways of the longest way and back along it.
  look(upwards, sideways, back) {
    this.resize();
    const side = new THREE.Vector3().crossVectors(this.along, UP);
    const direction = UP.clone().multiplyScalar(upwards).addScaledVector(side, sideways).addScaledVector(this.along, -back);
    direction.normalize();
    const right = new THREE.Vector3().crossVectors(UP, direction).normalize();
    const above = new THREE.Vector3().crossVectors(direction, right);
    const centre = this.box.getCenter(new THREE.Vector3());
    const half = Math.tan((this.camera.fov * Math.PI) / 360);
    const { left, right: end, top, bottom } = this.free;
    const wide = (0.92 * half * (end - left)) / window.innerHeight;
    const high = (0.8 * half * (bottom - top)) / window.innerHeight;
    let distance = 2;
    for (const point of this.points) {
      const offset = point.clone().sub(centre);
      const needed = Math.max(Math.abs(offset.dot(right)) / wide, Math.abs(offset.dot(above)) / high);
      distance = Math.max(distance, needed + offset.dot(direction));
    }
    this.camera.position.copy(centre).addScaledVector(direction, distance);
    this.controls.target.copy(centre);
    this.controls.update();
  }

  fit() {
    this.look(0.7, 0.9, 0.25);
  }

  top() {
    this.look(1, 1e-4, 0);
  }

  // Moves camera and target together, so that a followed robot stays where it is on the screen.
  follow(position) {
    const shift = position.clone().sub(this.controls.target).multiplyScalar(0.2);
    this.controls.target.add(shift);
    this.camera.position.add(shift);
  }

  // Moves camera and target to a point of G.
  moveTo(position) {
    const shift = this.world.localToWorld(new THREE.Vector3(...position)).sub(this.controls.target);
    this.controls.target.add(shift);
    this.camera.position.add(shift);
  }

  // Metres that a pixel shows at a point.
  metresPerPixel(point) {
    const distance = this.camera.position.distanceTo(point);
    return (2 * distance * Math.tan((this.camera.fov * Math.PI) / 360)) / window.innerHeight;
  }

  // Moves the camera on; whether it moved.
  advance() {
    return this.controls.update();
  }

  render() {
    this.renderer.render(this.scene, this.camera);
  }
}
