// The list of robots.
import { robotColor, STATES } from "./colors.js";

// Without a message for this long, a robot is silent, and its pose is old.
export const STALE_S = 3;

export function stateOf(robot) {
  return robot.is_online ? robot.status?.state : "gone";
}

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

  add(name, index) {
    const item = document.createElement("li");
    const button = document.createElement("button");
    button.className = "robot";
    button.addEventListener("click", () => this.onChoose(name));
    const parts = Object.fromEntries(
      ["number", "name", "state", "reason", "figures", "queries"].map((part) => [part, line(button, part)]));
    parts.name.textContent = name;
    parts.number.textContent = index < 9 ? `${index + 1}` : "";
    item.append(button);
    this.list.append(item);
    this.entries.set(name, { button, parts, index });
    this.applyTheme();
    document.getElementById("no-robots").hidden = true;
  }

  applyTheme() {
    for (const { button, index } of this.entries.values()) button.style.setProperty("--robot", robotColor(index));
  }

  setFollowed(name) {
    for (const [robot, { button }] of this.entries) {
      button.classList.toggle("is-followed", robot === name);
      button.setAttribute("aria-pressed", robot === name);
    }
  }

  // `robot`: as it was received; `elapsed_s` since then.
  update(robot, elapsed_s) {
    const { parts } = this.entries.get(robot.robot);
    const { status, pose, odometry, answer } = robot;
    const state = stateOf(robot);
    set(parts.state, STATES[state] ?? "no status yet");
    parts.state.className = `state ${state ?? "gone"}`;
    set(parts.reason, status?.reason ?? "");
    const figures = [];
    if (pose) {
      const [x, y, z] = pose.global_from_imu.position;
      const c = pose.global_from_imu.position_covariance;
      const sigma3 = 3 * Math.sqrt(Math.max((c[0][0] + c[1][1] + c[2][2]) / 3, 0));
      figures.push(`(${x.toFixed(2)}, ${y.toFixed(2)}, ${z.toFixed(2)}) m ± ${sigma3.toFixed(2)} m (3σ)`);
    }
    if (odometry) figures.push(`${odometry.speed_mps.toFixed(1)} m/s`);
    const newest = Math.min(...[pose, odometry, status].filter(Boolean).map((part) => part.age_s)) + elapsed_s;
    if (newest > STALE_S && newest < Infinity) figures.push(`nothing for ${newest.toFixed(0)} s`);
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
