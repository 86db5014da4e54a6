// Error of the position and 3 sigma over the time of a run.
import { robotColor, styleColor } from "./colors.js";

const MARGIN = { left: 52, right: 12, top: 20, bottom: 20 };

export function niceStep(span, count) {
  const raw = span / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= raw);
}

const length3 = (vector) => Math.hypot(...vector);
export const sigma3 = (c) => 3 * Math.sqrt(Math.max(c[0][0] + c[1][1] + c[2][2], 0));

// An empty canvas with as many pixels as the screen shows of it; sizes are in CSS pixels.
export function cleared(canvas) {
  const scale = window.devicePixelRatio;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = width * scale;
  canvas.height = height * scale;
  const context = canvas.getContext("2d");
  context.scale(scale, scale);
  return { context, width, height };
}

export class Chart {
  constructor(canvas, run) {
    this.canvas = canvas;
    this.run = run;
    this.points = run.global.length ? run.global : run.local;
    this.duration = Math.max(this.points.at(-1)?.t ?? 1, 1e-3);
    const highs = this.points.flatMap((point) => [sigma3(point.position_covariance), point.error_m ? length3(point.error_m) : 0]);
    highs.sort((a, b) => a - b);
    // The first bounds, before the map was used, may be far higher than the others.
    this.high = Math.max((highs[Math.floor(highs.length * 0.99)] ?? 1) * 1.1, 1e-3);
  }

  draw(now_s) {
    const { context, width, height } = cleared(this.canvas);
    const x = (t) => MARGIN.left + (t / this.duration) * (width - MARGIN.left - MARGIN.right);
    const y = (value) => height - MARGIN.bottom - (Math.min(value, this.high) / this.high) * (height - MARGIN.top - MARGIN.bottom);
    this.axes(context, x, y, width, height);
    context.beginPath();
    context.moveTo(x(this.points[0]?.t ?? 0), y(0));
    for (const point of this.points) context.lineTo(x(point.t), y(sigma3(point.position_covariance)));
    context.lineTo(x(this.duration), y(0));
    context.fillStyle = `${robotColor(0)}44`;
    context.fill();
    context.beginPath();
    let isDown = false;
    for (const point of this.points) {
      if (!point.error_m) {
        isDown = false;
        continue;
      }
      const [px, py] = [x(point.t), y(length3(point.error_m))];
      if (isDown) context.lineTo(px, py);
      else context.moveTo(px, py);
      isDown = true;
    }
    context.strokeStyle = styleColor("--text");
    context.lineWidth = 1.5;
    context.stroke();
    for (const [t, isUsed] of this.run.queries) {
      context.fillStyle = styleColor(isUsed ? "--localized" : "--odometry-only");
      context.fillRect(x(t), isUsed ? height - MARGIN.bottom + 1 : height - MARGIN.bottom + 5, 1.5, 4);
    }
    context.fillStyle = styleColor("--accent");
    context.fillRect(x(now_s) - 1, MARGIN.top, 2, height - MARGIN.top - MARGIN.bottom);
  }

  axes(context, x, y, width, height) {
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = styleColor("--faint");
    context.strokeStyle = styleColor("--line");
    context.lineWidth = 1;
    context.textAlign = "right";
    const step = niceStep(this.high, 4);
    for (let value = 0; value <= this.high; value += step) {
      context.beginPath();
      context.moveTo(MARGIN.left, y(value));
      context.lineTo(width - MARGIN.right, y(value));
      context.stroke();
      context.fillText(`${+value.toPrecision(3)} m`, MARGIN.left - 6, y(value) + 4);
    }
    context.textAlign = "center";
    const seconds = niceStep(this.duration, 8);
    for (let t = seconds; t < this.duration; t += seconds) context.fillText(`${+t.toPrecision(6)} s`, x(t), height - 1);
    context.textAlign = "left";
    const hasError = this.points.some((point) => point.error_m);
    const what = hasError ? "line: error of the position; area: 3σ" : "area: 3σ of the position (the run names no ground truth)";
    context.fillText(`${what}; ticks below: queries used (upper), not used (lower)`, MARGIN.left, 11);
  }
}
