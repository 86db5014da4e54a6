// The state of a robot, by when the server last heard of it: nobody is taken for well by what was said long ago.
import { STATES } from "./colors.js";
import { byName } from "./names.js";

// A robot states its status once a second: two are missing.
export const SILENT_S = 2.5;
// One that has been silent for this long is not expected back soon.
const UNREACHABLE_S = 60;
const ALARMS_SHOWN = 50;

const byId = (id) => document.getElementById(id);

// Seconds since its status, or whatever it publishes in place of one.
function age(robot, elapsed_s) {
  return (robot.status?.age_s ?? robot.heard_age_s) + elapsed_s;
}

// `robot`: as it was received; `elapsed_s` since then; `isConnected`: whether the server still tells.
export function stateOf(robot, elapsed_s, isConnected) {
  if (!isConnected) return "unknown";
  if (robot.is_off) return "off";
  const age_s = age(robot, elapsed_s);
  if (age_s > UNREACHABLE_S) return "unreachable";
  // Who ends without a word was killed, or lost its connection.
  if (age_s > SILENT_S || robot.has_ended) return "silent";
  return robot.status?.state ?? "nothing";
}

export function durationText(s) {
  if (s < 60) return `${Math.floor(s)} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min`;
  if (s < 86400) return `${Math.floor(s / 3600)} h ${Math.floor((s % 3600) / 60)} min`;
  return `${Math.floor(s / 86400)} d`;
}

// The state in words, with how long ago the robot was heard where that matters.
export function stateText(state, robot, elapsed_s) {
  const words = STATES[state];
  if (state === "silent" || state === "unreachable") {
    const isHeard = robot.heard_age_s + elapsed_s <= SILENT_S;
    const how = robot.has_ended ? ", disconnected" : isHeard ? ", no status" : "";
    return `${words}${how} for ${durationText(age(robot, elapsed_s))}`;
  }
  if (state === "off" || state === "unknown") return `${words}, heard ${durationText(robot.heard_age_s + elapsed_s)} ago`;
  return words;
}

// Why an operator should look at a robot; null where all is well.
export function alarmOf(state, robot, elapsed_s) {
  if (!["lost", "silent", "unreachable"].includes(state)) return null;
  const reason = state === "lost" && robot.status?.reason ? `: ${robot.status.reason}` : "";
  return `${stateText(state, robot, elapsed_s)}${reason}`;
}

// Counts by state, and alarms.
export class Fleet {
  constructor(onChoose) {
    this.onChoose = onChoose;
    this.shown = "";
  }

  // `robots`: name, state, alarm of each.
  show(robots) {
    const counts = Object.keys(STATES).map((state) => [state, robots.filter((robot) => robot.state === state).length]);
    const order = ["lost", "unreachable", "silent"];
    const alarms = robots.filter(({ alarm }) => alarm).sort(
      (a, b) => order.indexOf(a.state) - order.indexOf(b.state) || byName(a.name, b.name));
    const next = JSON.stringify([counts, alarms.slice(0, ALARMS_SHOWN), alarms.length]);
    if (next === this.shown) return;
    this.shown = next;
    byId("counts").hidden = robots.length === 0;
    byId("counts").replaceChildren(...counts.filter(([, count]) => count).map(([state, count]) => {
      const item = document.createElement("li");
      item.className = `state ${state}`;
      item.textContent = STATES[state].replace(" ", ` ${count} `);
      return item;
    }));
    this.list(alarms);
  }

  list(alarms) {
    const list = byId("alarms");
    const focused = list.contains(document.activeElement) ? document.activeElement.dataset.robot : null;
    list.hidden = alarms.length === 0;
    list.replaceChildren(...alarms.slice(0, ALARMS_SHOWN).map(({ name, state, alarm }) => {
      const item = document.createElement("li");
      const button = document.createElement("button");
      button.className = `state ${state}`;
      button.dataset.robot = name;
      button.textContent = `${alarm.slice(0, 1)} ${name}${alarm.slice(1)}`;
      button.addEventListener("click", () => this.onChoose(name));
      item.append(button);
      return item;
    }));
    [...list.querySelectorAll("button")].find(({ dataset }) => dataset.robot === focused)?.focus();
    const more = alarms.length - ALARMS_SHOWN;
    byId("more-alarms").textContent = `and ${more} more`;
    byId("more-alarms").hidden = more <= 0;
    // Read out when it changes, without the passing seconds.
    const count = alarms.length === 1 ? "1 alarm" : `${alarms.length} alarms`;
    if (byId("alarm-count").textContent !== count) byId("alarm-count").textContent = count;
  }
}
