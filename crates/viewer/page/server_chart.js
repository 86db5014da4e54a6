// How busy the map server was over the last hour.
import { cleared, niceStep } from "./chart.js";
import { robotColor, styleColor } from "./colors.js";

const PERIOD_MS = 5000;
const MARGIN = { left: 44, right: 8, top: 20, bottom: 18 };
const SHORTEST_S = 60;

// Series differ in their dashes as well as in their colours.
const PLOTS = [
  { title: "queries per second", series: [
    { key: "answered_per_s", name: "answered", dash: [] },
    { key: "failed_per_s", name: "failed", dash: [2, 2] },
    { key: "refused_per_s", name: "busy", dash: [7, 4] },
  ] },
  { title: "time of a query, ms", series: [
    { key: "p50_ms", name: "median", dash: [] },
    { key: "p99_ms", name: "99 %", dash: [7, 4] },
  ] },
  { title: "queries waiting", series: [{ key: "waiting", name: "waiting", dash: [] }] },
];

export class ServerChart {
  constructor() {
    this.canvas = document.getElementById("server-chart");
    this.figures = document.getElementById("server-figures");
    this.samples = [];
    this.isOpen = false;
    this.until = null;
    setInterval(() => this.load(), PERIOD_MS);
    window.addEventListener("resize", () => this.draw());
  }

  setOpen(isOpen) {
    this.isOpen = isOpen;
    this.load();
  }

  // Marks a time, seconds since 1970; null for the present.
  setUntil(t) {
    this.until = t;
    this.draw();
  }

  async load() {
    if (!this.isOpen || document.hidden) return;
    try {
      const response = await fetch("api/statistics");
      const { now_ms: now, period_s: period, samples } = await response.json();
      Object.assign(this, { now: now / 1000, period, samples });
    } catch {
      // The connection is shown elsewhere.
    }
    this.draw();
  }

  draw() {
    if (!this.isOpen || this.samples.length === 0) return;
    this.canvas.hidden = false;
    const { until } = this;
    const at = until === null ? this.samples.at(-1) : this.samples.findLast(({ t_ms: t }) => t / 1000 <= until);
    if (at) {
      const times = at.p50_ms === null ? "" : `, median ${at.p50_ms.toFixed(0)} ms, 99 % within ${at.p99_ms.toFixed(0)} ms`;
      this.figures.textContent = `${at.answered_per_s.toFixed(1)} queries/s${times}, ${at.refused_per_s.toFixed(1)}/s refused as busy, ${at.waiting} waiting.`;
    }
    const { context, width, height } = cleared(this.canvas);
    context.font = "11px system-ui, sans-serif";
    const each = height / PLOTS.length;
    PLOTS.forEach((plot, number) => this.plot(context, plot, { top: number * each, height: each, width }));
  }

  plot(context, { title, series }, { top, height, width }) {
    const values = series.flatMap(({ key }) => this.samples.map((sample) => sample[key] ?? 0));
    const high = Math.max(...values, 1e-9) > 1e-6 ? Math.max(...values) * 1.1 : 1;
    const span = Math.max(this.now - this.samples[0].t_ms / 1000, SHORTEST_S);
    const x = (t) => MARGIN.left + (1 - (this.now - t) / span) * (width - MARGIN.left - MARGIN.right);
    const y = (value) => top + height - MARGIN.bottom - (value / high) * (height - MARGIN.top - MARGIN.bottom);
    this.axes(context, { high, span, x, y, width, bottom: top + height });
    series.forEach(({ key, dash }, number) => {
      context.beginPath();
      let isDown = false;
      for (const sample of this.samples) {
        const value = sample[key];
        if (value === null) isDown = false;
        else {
          const end = sample.t_ms / 1000;
          if (!isDown) context.moveTo(x(end - this.period), y(value));
          context.lineTo(x(end), y(value));
          isDown = true;
        }
      }
      context.setLineDash(dash);
      context.strokeStyle = robotColor(number);
      context.lineWidth = 1.7;
      context.stroke();
      context.setLineDash([]);
    });
    if (this.until !== null) {
      context.fillStyle = styleColor("--text");
      context.fillRect(x(this.until) - 0.5, top + MARGIN.top, 1, height - MARGIN.top - MARGIN.bottom);
    }
    this.legend(context, title, series, top + 12);
  }

  axes(context, { high, span, x, y, width, bottom }) {
    context.fillStyle = styleColor("--faint");
    context.strokeStyle = styleColor("--line");
    context.lineWidth = 1;
    context.textAlign = "right";
    const step = niceStep(high, 3);
    for (let value = 0; value <= high; value += step) {
      context.beginPath();
      context.moveTo(MARGIN.left, y(value));
      context.lineTo(width - MARGIN.right, y(value));
      context.stroke();
      context.fillText(`${+value.toPrecision(3)}`, MARGIN.left - 6, y(value) + 4);
    }
    context.textAlign = "center";
    const minutes = niceStep(span / 60, 3);
    for (let ago = minutes; ago < span / 60; ago += minutes) {
      context.fillText(`−${+ago.toPrecision(3)} min`, x(this.now - 60 * ago), bottom - 3);
    }
  }

  legend(context, title, series, y) {
    context.textAlign = "left";
    context.fillStyle = styleColor("--text");
    context.fillText(title, 0, y);
    let at = context.measureText(title).width + 14;
    if (series.length < 2) return;
    series.forEach(({ name, dash }, number) => {
      context.beginPath();
      context.setLineDash(dash);
      context.strokeStyle = robotColor(number);
      context.lineWidth = 2;
      context.moveTo(at, y - 4);
      context.lineTo(at + 18, y - 4);
      context.stroke();
      context.setLineDash([]);
      context.fillStyle = styleColor("--text");
      context.fillText(name, at + 22, y);
      at += 34 + context.measureText(name).width;
    });
  }
}
