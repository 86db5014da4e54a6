// Colours of robots and states, after those of Okabe and Ito, which people with any colour vision tell apart. Green, amber and
// orange say how a robot is, and are nobody's colour.

const ROBOTS = {
  dark: ["#56b4e9", "#cc79a7", "#f0e442", "#b79cff", "#d8bfa0", "#5c8dff", "#ff9ed2", "#9be0f5", "#c7b83a"],
  light: ["#0072b2", "#a3447c", "#7a6a00", "#6a45c0", "#7d5a3c", "#2f4fd0", "#c2187a", "#00708a", "#5a5a00"],
};

export function theme() {
  return document.documentElement.dataset.theme === "light" ? "light" : "dark";
}

export function robotColor(index) {
  const colors = ROBOTS[theme()];
  return colors[index % colors.length];
}

export function styleColor(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

// States differ in sign and word as well as in colour.
export const STATES = {
  localized: "● localized",
  odometry_only: "◐ odometry only",
  lost: "✕ lost",
  starting: "◌ starting",
  silent: "△ silent",
  unreachable: "▽ unreachable",
  nothing: "◌ no status",
  unknown: "? not known",
  off: "○ off",
};

// Dark blue over grey to yellow (as cividis): the lowest to the highest landmark.
const RAMP = [[0.17, 0.35, 0.61], [0.55, 0.55, 0.53], [0.90, 0.81, 0.31]];

export function rampColor(share, into, at) {
  const scaled = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1);
  const low = Math.min(Math.floor(scaled), RAMP.length - 2);
  const part = scaled - low;
  for (let channel = 0; channel < 3; channel += 1) {
    // The renderer takes linear light.
    into[at + channel] = (RAMP[low][channel] * (1 - part) + RAMP[low + 1][channel] * part) ** 2.2;
  }
}
