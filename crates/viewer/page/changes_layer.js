// Keyframes that moved, appeared or are gone: since the release before, or in a candidate.
import * as THREE from "three";
import { styleColor } from "./colors.js";
import { frustumEnds } from "./map_layer.js";

// Larger than the keyframes that they are drawn about.
const SIZE = 1.3;
const KINDS = { moved: "--moved", added: "--added", removed: "--removed" };

// What is drawn of a change, in words; signs tell the kinds as well as colours.
export function changeText(change) {
  const count = ({ count: all }) => all.toLocaleString("en");
  const parts = [];
  if (change.moved.count) parts.push(`→ ${count(change.moved)} moved, by ${change.largest_motion_m.toFixed(2)} m at most`);
  if (change.added.count) parts.push(`+ ${count(change.added)} new`);
  if (change.removed.count) parts.push(`− ${count(change.removed)} gone`);
  return parts.length ? parts.join("; ") : "the same keyframes";
}

export class ChangesLayer {
  // `isDashed`: as what is only proposed is drawn.
  constructor(scene, isDashed) {
    this.isDashed = isDashed;
    this.group = new THREE.Group();
    this.group.visible = false;
    scene.world.add(this.group);
  }

  // `change`: as it was received, null for none; `size`: of the frusta of keyframes, metres.
  set(change, size) {
    for (const part of [...this.group.children]) {
      this.group.remove(part);
      part.geometry.dispose();
      part.material.dispose();
    }
    if (!change) return;
    for (const kind of Object.keys(KINDS)) {
      const { drawn } = change[kind];
      if (drawn.length) this.group.add(this.lines(kind, drawn, size));
    }
    this.applyTheme();
  }

  show(isVisible) {
    this.group.visible = isVisible;
  }

  applyTheme() {
    for (const part of this.group.children) part.material.color.set(styleColor(KINDS[part.name]));
  }

  lines(kind, drawn, size) {
    const places = kind === "moved" ? drawn.map(({ now }) => now) : drawn;
    const ways = kind === "moved" ? drawn.flatMap(({ before, now }) => [...before.position, ...now.position]) : [];
    const frusta = frustumEnds(places, SIZE * size);
    const ends = new Float32Array(frusta.length + ways.length);
    ends.set(frusta);
    ends.set(ways, frusta.length);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(ends, 3));
    const look = { depthTest: false, transparent: true };
    const dashes = { dashSize: 0.15 * size, gapSize: 0.1 * size };
    const material = this.isDashed ? new THREE.LineDashedMaterial({ ...look, ...dashes }) : new THREE.LineBasicMaterial(look);
    const lines = new THREE.LineSegments(geometry, material);
    if (this.isDashed) lines.computeLineDistances();
    lines.name = kind;
    lines.renderOrder = 1;
    return lines;
  }
}

// The layers of a page: what changed since the release before, and an open candidate.
export class Changes {
  constructor(scene) {
    this.layers = { since: new ChangesLayer(scene, false), candidate: new ChangesLayer(scene, true) };
  }

  // `answer`: of /api/maps/{map}/changes, null for a map without; `size`: of the frusta of keyframes, metres.
  set(answer, size) {
    for (const [name, layer] of Object.entries(this.layers)) {
      const change = answer?.[name] ?? null;
      layer.set(change, size);
      const label = document.getElementById(`${name}-layer`);
      label.hidden = change === null;
      if (change) label.querySelector("span").textContent = this.title(name, change);
    }
    return Object.fromEntries(Object.entries(this.layers).map(([name, { group }]) => [name, group.children.map((part) => part.name)]));
  }

  title(name, change) {
    const of = name === "since" ? `since ${change.release}` : change.release;
    return `${of}: ${changeText(change)}`;
  }

  show(name, isVisible) {
    this.layers[name]?.show(isVisible);
  }

  applyTheme() {
    Object.values(this.layers).forEach((layer) => layer.applyTheme());
  }
}
