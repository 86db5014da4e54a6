// Colours of robots and states: those of Okabe and Ito, which people with any colour vision tell apart.

const ROBOTS = {
  dark: ["#56b4e9", "#e69f00", "#cc79a7", "#f0e442", "#2fbf94", "#ff7f3f", "#5c9dff"],
  light: ["#0072b2", "#d55e00", "#a3447c", "#8a7a00", "#009e73", "#b37a00", "#3b62c4"],
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
  gone: "○ gone",
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
