// A recorded run: its tracks, a time slider and the chart.
import * as THREE from "three";
import { pose } from "./map_layer.js";
import { Chart } from "./chart.js";
import { styleColor } from "./colors.js";

// The last point of a track at or before a time.
function pointAt(points, t) {
  let [low, high] = [0, points.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (points[middle].t <= t) low = middle + 1;
    else high = middle;
  }
  return points[Math.max(low - 1, 0)];
}

export class Replay {
  constructor(scene, run, robot) {
    this.run = run;
    this.robot = robot;
    this.now = 0;
    this.isPlaying = false;
    this.chart = new Chart(document.getElementById("chart"), run);
    document.documentElement.classList.add("is-run");
    document.getElementById("replay").hidden = false;
    robot.trail.set(run.global.map((point) => point.position));
    const anchor = run.global_from_local[0];
    const fromLocal = anchor ? pose(anchor.rotation_wxyz, anchor.position) : new THREE.Matrix4();
    robot.odometry.set(run.local.map((point) => new THREE.Vector3(...point.position).applyMatrix4(fromLocal).toArray()));
    const truth = new THREE.BufferGeometry().setFromPoints(run.truth.map((point) => new THREE.Vector3(...point.position)));
    this.truth = new THREE.Line(truth, new THREE.LineBasicMaterial());
    scene.world.add(this.truth);
    this.slider = document.getElementById("time");
    this.slider.addEventListener("input", () => this.seek((this.slider.value / 1000) * this.chart.duration));
    document.getElementById("play").addEventListener("click", () => this.toggle());
    window.addEventListener("resize", () => this.chart.draw(this.now));
    this.applyTheme();
    this.seek(this.chart.duration);
  }

  points() {
    return [...this.run.global, ...this.run.truth].map((point) => point.position);
  }

  applyTheme() {
    this.truth.material.color.set(styleColor("--text"));
    this.chart.draw(this.now);
  }

  toggle() {
    this.isPlaying = !this.isPlaying;
    if (this.isPlaying && this.now >= this.chart.duration) this.seek(0);
    document.getElementById("play").textContent = this.isPlaying ? "Pause" : "Play";
  }

  seek(t) {
    this.now = Math.min(Math.max(t, 0), this.chart.duration);
    this.slider.value = (1000 * this.now) / this.chart.duration;
    document.getElementById("clock").textContent = `${this.now.toFixed(1)} of ${this.chart.duration.toFixed(1)} s`;
    if (this.run.global.length) this.robot.setPose(pointAt(this.run.global, this.now), false);
    window.driftless.robots[this.run.name] = { position: this.robot.position };
    this.chart.draw(this.now);
  }

  // Plays at the speed of the recording.
  step(seconds) {
    if (!this.isPlaying) return;
    this.seek(this.now + seconds);
    if (this.now >= this.chart.duration) this.toggle();
  }
}
