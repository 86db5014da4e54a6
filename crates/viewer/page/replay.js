// A recorded run: its tracks, a time slider and the chart.
import * as THREE from "three";
import { pose } from "./map_layer.js";
import { Chart } from "./chart.js";
import { styleColor } from "./colors.js";
import { Timeline, indexAt } from "./timeline.js";

const STEPS = 1000;

export class Replay {
  // `onSettle(t)`: a time was chosen, seconds since the start.
  constructor(scene, run, robot, onSettle) {
    this.run = run;
    this.robot = robot;
    this.chart = new Chart(document.getElementById("chart"), run);
    document.documentElement.classList.add("is-run");
    robot.trail.set(run.global.map((point) => point.position));
    const anchor = run.global_from_local[0];
    const fromLocal = anchor ? pose(anchor.rotation_wxyz, anchor.position) : new THREE.Matrix4();
    robot.odometry.set(run.local.map((point) => new THREE.Vector3(...point.position).applyMatrix4(fromLocal).toArray()));
    const truth = new THREE.BufferGeometry().setFromPoints(run.truth.map((point) => new THREE.Vector3(...point.position)));
    this.truth = new THREE.Line(truth, new THREE.LineBasicMaterial());
    scene.world.add(this.truth);
    const { duration } = this.chart;
    const describe = (t) => `${t.toFixed(1)} of ${duration.toFixed(1)} s`;
    this.timeline = new Timeline({ steps: STEPS, onSeek: (t) => this.show(t), describe, onSettle });
    this.timeline.setRange(0, duration);
    window.addEventListener("resize", () => this.chart.draw(this.timeline.now));
    this.applyTheme();
    this.timeline.seek(duration);
  }

  points() {
    return [...this.run.global, ...this.run.truth].map((point) => point.position);
  }

  applyTheme() {
    this.truth.material.color.set(styleColor("--text"));
    this.chart.draw(this.timeline.now);
  }

  show(t) {
    const { global } = this.run;
    if (global.length) this.robot.setPose(global[Math.max(indexAt(global, t), 0)], false);
    window.driftless.robots[this.run.name] = { position: this.robot.position };
    this.chart.draw(t);
  }
}
