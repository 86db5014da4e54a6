// The list of robots.
import { robotColor } from "./colors.js";
import { byName, colorNumber } from "./names.js";
import { SILENT_S, durationText, stateText } from "./presence.js";

function line(parent, className) {
  const element = document.createElement(className.startsWith("name") || className === "number" ? "span" : "small");
  element.className = className;
  parent.append(element);
  return element;
}

export class Panel {
  constructor(onChoose) {
    this.list = document.getElementById("robot-list");
    this.entries = new Map();
    this.onChoose = onChoose;
  }

  add(name) {
    const item = document.createElement("li");
    const button = document.createElement("button");
    button.className = "robot";
    button.addEventListener("click", () => this.onChoose(name));
    const parts = Object.fromEntries(
      ["number", "name", "state", "reason", "figures", "queries"].map((part) => [part, line(button, part)]));
    parts.name.textContent = name;
    item.append(button);
    this.list.append(item);
    this.entries.set(name, { item, button, parts, name });
    this.applyTheme();
    document.getElementById("no-robots").hidden = true;
  }

  applyTheme() {
    for (const { button, name } of this.entries.values()) button.style.setProperty("--robot", robotColor(colorNumber(name)));
  }

  // `keys`: the keys by which robots are followed.
  setKeys(keys) {
    for (const { parts, name } of this.entries.values()) set(parts.number, `${keys.get(name) ?? ""}`);
  }

  // By name; those that are off at the end. Nothing moves without need, so that a focus stays.
  sort() {
    const entries = [...this.entries.values()];
    entries.sort((a, b) => Number(a.isOff ?? false) - Number(b.isOff ?? false) || byName(a.name, b.name));
    entries.forEach(({ item }, at) => {
      if (this.list.children[at] !== item) this.list.insertBefore(item, this.list.children[at] ?? null);
    });
  }

  setFollowed(name) {
    for (const [robot, { button }] of this.entries) {
      button.classList.toggle("is-followed", robot === name);
      button.setAttribute("aria-pressed", robot === name);
    }
  }

  // `robot`: as it was received; `elapsed_s` since then; `heading`: in degrees, null where it is not known.
  update(robot, state, elapsed_s, heading) {
    const entry = this.entries.get(robot.robot);
    const { parts } = entry;
    const { status, pose, odometry, answer } = robot;
    set(parts.state, stateText(state, robot, elapsed_s));
    if (entry.state !== state) {
      entry.state = state;
      entry.isOff = state === "off";
      parts.state.className = `state ${state}`;
      entry.button.className = `robot of-${state}${entry.button.classList.contains("is-followed") ? " is-followed" : ""}`;
      this.isSorted = false;
    }
    set(parts.reason, status?.state === state ? status.reason : "");
    const figures = [];
    if (pose) {
      const [x, y, z] = pose.global_from_imu.position;
      const c = pose.global_from_imu.position_covariance;
      const sigma3 = 3 * Math.sqrt(Math.max((c[0][0] + c[1][1] + c[2][2]) / 3, 0));
      figures.push(`(${x.toFixed(2)}, ${y.toFixed(2)}, ${z.toFixed(2)}) m ± ${sigma3.toFixed(2)} m (3σ)`);
    }
    if (pose && heading !== null) figures.push(`heading ${heading.toFixed(0)}°`);
    if (odometry) figures.push(`${odometry.speed_mps.toFixed(1)} m/s`);
    const old_s = pose ? pose.age_s + elapsed_s : 0;
    if (old_s > SILENT_S) figures.push(`${durationText(old_s)} old`);
    set(parts.figures, figures.join(", "));
    const queries = [];
    if (robot.queries !== undefined) queries.push(robot.queries);
    else if (status) queries.push(`${status.queries_answered} of ${status.queries_sent} queries answered, ${status.keyframes_held} keyframes held`);
    if (answer) queries.push(answer.keyframes.length ? `last answer: ${answer.keyframes.length} keyframes` : "last answer: no match");
    set(parts.queries, queries.join("; "));
  }
}

function set(element, text) {
  if (element.textContent !== text) element.textContent = text;
}
