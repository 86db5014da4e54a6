// The last hour: the slider goes back in it, a button returns to the present.
import { Timeline, indexAt } from "./timeline.js";

// A robot without a sample for so many steps was not there.
const MISSED_STEPS = 10;
// A clock that moved by more than this was set.
const SET_S = 60;

const pad = (number) => `${number}`.padStart(2, "0");

export function clockText(t) {
  const date = new Date(1000 * t);
  return `${pad(date.getHours())}:${pad(date.getMinutes())}:${pad(date.getSeconds())}`;
}

// With date and time zone.
export function dateText(t) {
  const date = new Date(1000 * t);
  const day = date.toLocaleDateString("en-GB", { day: "numeric", month: "short", year: "numeric" });
  const minutes = -date.getTimezoneOffset();
  const [hours, rest] = [Math.floor(Math.abs(minutes) / 60), Math.abs(minutes) % 60];
  const zone = minutes === 0 ? "UTC" : `UTC${minutes < 0 ? "−" : "+"}${hours}${rest ? `:${pad(rest)}` : ""}`;
  return `${day}, ${clockText(t)} ${zone}`;
}

// A time of a link: seconds since 1970, or as in 2026-05-01T12:00:00Z; NaN for what is neither.
export function timeOfLink(text) {
  return /^\d+(\.\d+)?$/.test(text) ? Number(text) : Date.parse(text) / 1000;
}

export function linkOfTime(t) {
  return `${new Date(1000 * t).toISOString().slice(0, 19)}Z`;
}

function matrix([xx, xy, xz, yy, yz, zz]) {
  return [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
}

// What a robot did, with times in seconds.
function track({ samples, changes }) {
  const points = samples.map(({ t_ms: t, state, matched, unmatched, pose }) => ({
    t: t / 1000, state, matched, unmatched,
    pose: pose && { ...pose, position_covariance: matrix(pose.position_covariance) },
  }));
  let count = 0;
  for (const point of points) {
    if (point.pose) count += 1;
    point.trail = count;
  }
  return {
    points,
    trail: points.filter(({ pose }) => pose).map(({ pose }) => pose.position),
    changes: changes.map((change) => ({ ...change, t: change.t_ms / 1000 })),
  };
}

// The state of a robot at a time: that of its last sample, unless it changed since.
export function stateAt(point, change) {
  if (point && !(change?.t > point.t)) return point.state;
  return change?.state ?? "nothing";
}

export class History {
  // `load()`: the answer of /api/history; `robotNames()`, `robotOf(name)`: the robots of the page; `onShown(t)`: a time is shown, null for the
  // present; `onSettle(t)`: one was chosen; `onError(error)`: it could not be loaded.
  constructor({ load, robotNames, robotOf, onShown, onSettle, onError }) {
    Object.assign(this, { load, robotNames, robotOf, onShown, onSettle, onError });
    this.isLive = true;
    this.tracks = null;
    this.loading = null;
    this.loads = 0;
    this.offset = null;
    this.since = null;
    this.timeline = new Timeline({
      steps: 1,
      onSeek: (t) => this.show(t),
      describe: (t) => (this.isLive ? dateText(t) : this.describe(t)),
      // What was asked for may still be loading.
      onSettle: () => onSettle(this.isLive ? null : this.wanted),
      onInput: (t, isEnd) => this.onInput(t, isEnd),
      onToggle: () => this.toggle(),
    });
    this.button = document.getElementById("live");
    this.button.addEventListener("click", () => this.goLive());
  }

  // The server's time, seconds since 1970.
  now() {
    return this.offset + performance.now() / 1000;
  }

  // A step of the slider is a second.
  setRange(from, to) {
    this.timeline.setRange(Math.min(from, to - 1), to, Math.max(Math.ceil(to - from), 1));
  }

  describe(t) {
    const ago = Math.max(Math.round(this.timeline.to - t), 0);
    const step = this.step > 1 ? `, every ${this.step} s` : "";
    return `${dateText(t)}, ${Math.floor(ago / 60)}:${pad(ago % 60)} min ago${step}`;
  }

  // The time of a message; returns whether the server's clock was set since the one before.
  note(update) {
    const before = this.offset;
    this.offset = update.time_ms / 1000 - performance.now() / 1000;
    this.since = update.history_since_ms && update.history_since_ms / 1000;
    return before !== null && Math.abs(this.offset - before) > SET_S;
  }

  onInput(t, isEnd) {
    if (isEnd) this.goLive();
    else this.seek(t);
    return false;
  }

  // Goes to a time; loads the history where the present was shown.
  async seek(t) {
    this.wanted = t;
    if (this.isLive) {
      this.isLive = false;
      this.button.setAttribute("aria-pressed", "false");
      this.loading = this.reload();
    }
    try {
      await this.loading;
    } catch (error) {
      this.onError(error);
      this.goLive();
    }
    if (!this.isLive) this.timeline.seek(this.wanted);
  }

  // From the present, plays all that there is.
  async toggle() {
    if (!this.isLive) return this.timeline.toggle();
    await this.seek(this.timeline.from);
    if (!this.isLive) this.timeline.setPlaying(true);
  }

  async reload() {
    this.loads += 1;
    const number = this.loads;
    const answer = await this.load();
    // The present is shown again, or the history of another map was asked for.
    if (this.isLive || number !== this.loads) return;
    this.tracks = new Map(answer.robots.map((robot) => [robot.robot, track(robot)]));
    // Others have done nothing yet.
    for (const name of this.robotNames()) {
      if (!this.tracks.has(name)) this.tracks.set(name, track({ samples: [], changes: [] }));
    }
    this.step = answer.step_ms / 1000;
    const to = answer.now_ms / 1000;
    this.setRange(answer.since_ms === null ? to : answer.since_ms / 1000, to);
    for (const [name, { trail }] of this.tracks) this.robotOf(name).showPast(trail);
  }

  // Where the map changed, what is shown must be of the new one.
  async refresh() {
    if (this.isLive) return;
    await this.reload();
    if (!this.isLive) this.timeline.seek(this.timeline.now);
  }

  // The tracks are of another map.
  forget() {
    for (const track of this.tracks?.values() ?? []) Object.assign(track, { points: [], trail: [] });
  }

  show(t) {
    if (this.isLive || !this.tracks) return;
    for (const [name, { points, changes }] of this.tracks) {
      const robot = this.robotOf(name);
      const point = points[indexAt(points, t)];
      const change = changes[indexAt(changes, t)];
      const isRecent = point && t - point.t <= MISSED_STEPS * Math.max(this.step, 1);
      const state = stateAt(isRecent ? point : null, change);
      const isThere = isRecent && state !== "off" && state !== "silent";
      robot.setPast(isThere ? point.pose : null, point?.trail ?? 0);
      robot.past = pastOf(name, isThere ? point : null, state, change, t);
    }
    this.onShown(t);
  }

  goLive() {
    if (this.isLive) return;
    this.isLive = true;
    this.timeline.setPlaying(false);
    this.button.setAttribute("aria-pressed", "true");
    for (const [name, { trail }] of this.tracks ?? []) this.robotOf(name).showPresent(trail);
    this.tracks = null;
    this.onShown(null);
    this.onSettle(null);
  }

  // Before each picture.
  frame(seconds) {
    if (!this.isLive) {
      this.timeline.step(seconds);
    } else if (this.offset !== null) {
      const now = this.now();
      this.setRange(this.since ?? now, now);
      this.timeline.place(now);
    }
  }
}

// A robot of the past, in the form in which it is published.
function pastOf(name, point, state, change, t) {
  const isStated = !["off", "silent", "unknown", "nothing"].includes(state);
  return {
    robot: name,
    state: state === "unknown" ? "nothing" : state,
    status: isStated ? { state, reason: change?.state === state ? change.reason : "", age_s: 0 } : null,
    heard_age_s: change && !isStated ? t - change.t : 0,
    pose: point?.pose ? { global_from_imu: point.pose, age_s: 0 } : null,
    queries: point ? `${point.matched} queries recognized, ${point.unmatched} not` : "",
  };
}
