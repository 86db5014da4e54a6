// The time slider, for a recorded run and for the last hour.

// The last point of a track at or before a time; -1 for none.
export function indexAt(points, t) {
  let [low, high] = [0, points.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (points[middle].t <= t) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

const byId = (id) => document.getElementById(id);

// Times are seconds.
export class Timeline {
  // `onSeek(t)`: shows a time; `describe(t)`: its text; `onSettle(t)`: the slider was let go.
  // `onInput(t, isEnd)`: whether the slider may go there by itself.
  constructor({ steps, onSeek, describe, onSettle = () => {}, onInput = () => true, onToggle = () => this.toggle() }) {
    this.steps = steps;
    this.onSeek = onSeek;
    this.describe = describe;
    this.isPlaying = false;
    [this.from, this.to, this.now] = [0, 1, 0];
    this.slider = byId("time");
    this.slider.max = steps;
    this.slider.addEventListener("input", () => {
      const t = this.from + (this.slider.value / this.steps) * (this.to - this.from);
      if (onInput(t, Number(this.slider.value) === this.steps)) this.seek(t);
    });
    this.slider.addEventListener("change", () => onSettle(this.now));
    byId("play").addEventListener("click", onToggle);
    byId("replay").hidden = false;
  }

  setRange(from, to, steps = this.steps) {
    [this.from, this.to, this.steps] = [from, Math.max(to, from + 1e-3), steps];
    if (Number(this.slider.max) !== steps) this.slider.max = steps;
  }

  // Puts the slider to a time without showing it.
  place(t) {
    this.now = Math.min(Math.max(t, this.from), this.to);
    const value = Math.round((this.steps * (this.now - this.from)) / (this.to - this.from));
    if (Number(this.slider.value) !== value) this.slider.value = value;
    const text = this.describe(this.now);
    if (byId("clock").textContent === text) return;
    byId("clock").textContent = text;
    this.slider.setAttribute("aria-valuetext", text);
  }

  seek(t) {
    this.place(t);
    this.onSeek(this.now);
  }

  setPlaying(isPlaying) {
    this.isPlaying = isPlaying;
    byId("play").textContent = isPlaying ? "Pause" : "Play";
  }

  toggle() {
    this.setPlaying(!this.isPlaying);
    if (this.isPlaying && this.now >= this.to) this.seek(this.from);
  }

  // Plays at the speed at which it was recorded.
  step(seconds) {
    if (!this.isPlaying) return;
    this.seek(this.now + seconds);
    if (this.now >= this.to) this.setPlaying(false);
  }
}
