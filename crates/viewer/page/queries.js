// The last queries: what the server found out about each, and why it refused it.
import { clockText, dateText } from "./history.js";

const PERIOD_MS = 1000;
// Of those that the page keeps, so many are listed.
const KEPT = 512;
const LISTED = 60;

const byId = (id) => document.getElementById(id);

// How a query ended: class, sign and words differ as well as the colour.
const OUTCOMES = {
  matched: ["good", "●", "recognized", "Recognized."],
  no_match: ["refused", "○", "no match", "Not recognized: no keyframe looks like the image."],
  not_verified: ["refused", "◐", "not verified", "Not recognized: some keyframes look alike, but no pose explains the matches."],
  too_few_features: ["refused", "○", "too few features", "Not recognized: the image has too few features."],
  empty_map: ["refused", "○", "empty map", "Not recognized: the map has no keyframes."],
  ambiguous: ["refused", "◑", "ambiguous", "Not recognized: two places of the map look alike."],
  busy: ["failed", "✕", "busy", "Refused: the server had too many queries."],
};

const VERDICTS = {
  in_answer: "part of the answer",
  verified: "verified, but not part of the answer",
  pose_uncertain: "refused: pose too uncertain",
  no_pose: "refused: no pose fits",
  too_few_matches: "refused: too few matches",
  not_compared: "not compared: enough others agreed",
};

function outcomeOf({ outcome, error, message }) {
  return OUTCOMES[outcome ?? error] ?? ["failed", "✕", error ?? outcome, `Failed: ${message ?? outcome}`];
}

function cell(row, text) {
  const td = document.createElement("td");
  td.textContent = text;
  row.append(td);
  return td;
}

export class Queries {
  // `onShown(query)`: the query whose candidates are to be drawn, null for none. `onKeyframe(map, id)`: somebody asks what a candidate is.
  constructor(onShown, onKeyframe) {
    this.onShown = onShown;
    this.onKeyframe = onKeyframe;
    this.select = byId("query-robot");
    this.select.addEventListener("change", () => this.restart());
    this.isOpen = false;
    this.until = null;
    this.session = 0;
    this.restart();
    setInterval(() => this.load(), PERIOD_MS);
  }

  addRobot(name) {
    this.select.append(new Option(name, name));
  }

  // Lists the queries of a robot; of everybody for null.
  setRobot(name) {
    if (this.select.value === (name ?? "")) return;
    this.select.value = name ?? "";
    this.restart();
  }

  setOpen(isOpen) {
    this.isOpen = isOpen;
    if (isOpen) this.load();
    this.show();
  }

  // Lists what was asked until a time, seconds since 1970; null for the present.
  setUntil(t) {
    const before = this.listed()[0]?.number;
    this.until = t;
    if (this.listed()[0]?.number !== before) this.show();
  }

  restart() {
    this.session += 1;
    this.queries = [];
    this.chosen = null;
    this.show();
    this.load();
  }

  // Shows a query of anybody, also while others come in.
  pin({ number }) {
    this.select.value = "";
    this.restart();
    this.chosen = number;
  }

  async load() {
    if (!this.isOpen || this.isLoading || document.hidden) return;
    this.isLoading = true;
    const { session } = this;
    const parameters = new URLSearchParams({ after: this.queries[0]?.number ?? 0, limit: KEPT });
    const query = `${parameters}${this.select.value ? `&robot=${encodeURIComponent(this.select.value)}` : ""}`;
    try {
      const response = await fetch(`api/queries?${query}`);
      const { queries } = await response.json();
      if (session === this.session && queries.length) {
        this.queries = [...queries, ...this.queries].slice(0, KEPT);
        this.show();
      }
    } catch {
      // The connection is shown elsewhere; the next second tries again.
    } finally {
      this.isLoading = false;
      if (session !== this.session) this.load();
    }
  }

  // Those of the time that is shown, newest first.
  listed() {
    const end = this.until === null ? Infinity : 1000 * this.until;
    return this.queries.filter(({ time_ms: time }) => time <= end);
  }

  show() {
    const listed = this.listed();
    const chosen = listed.find(({ number }) => number === this.chosen) ?? listed[0] ?? null;
    const list = byId("query-list");
    const focused = list.contains(document.activeElement) ? document.activeElement.dataset.number : null;
    list.replaceChildren(...listed.slice(0, LISTED).map((query) => this.entry(query, query === chosen)));
    if (focused) list.querySelector(`[data-number="${focused}"]`)?.focus();
    byId("no-queries").hidden = listed.length > 0;
    byId("query-detail").hidden = !chosen;
    if (chosen) this.describe(chosen);
    this.onShown(this.isOpen ? chosen : null);
  }

  entry(query, isChosen) {
    const [kind, sign, words] = outcomeOf(query);
    const item = document.createElement("li");
    const button = document.createElement("button");
    button.className = `query${isChosen ? " is-chosen" : ""}`;
    button.dataset.number = query.number;
    button.setAttribute("aria-pressed", isChosen);
    const client = query.kind === "image" ? "(an image)" : query.client.slice(0, 8) || "unnamed";
    const who = this.select.value ? "" : ` ${query.robot ?? client}`;
    const parts = [[clockText(query.time_ms / 1000), ""], [`${sign} ${words}${who}`, kind], [`${query.duration_ms.toFixed(0)} ms`, ""]];
    for (const [text, className] of parts) {
      const span = document.createElement(className ? "span" : "small");
      span.className = className;
      span.textContent = text;
      button.append(span);
    }
    button.title = dateText(query.time_ms / 1000);
    // Pinned while others come in; once more lets it go.
    button.addEventListener("click", () => {
      this.chosen = this.chosen === query.number ? null : query.number;
      this.show();
    });
    item.append(button);
    return item;
  }

  describe(query) {
    const [kind, sign, , sentence] = outcomeOf(query);
    const outcome = byId("query-outcome");
    outcome.className = kind;
    outcome.textContent = `${sign} ${sentence}`;
    const figures = [`${query.kind} in map ${query.map}`];
    if (query.outcome) {
      figures.push(`version ${query.map_version}`, `${query.features} features`);
      figures.push(query.prior_in_global ? "with a prior" : "without a prior");
      if (query.kind === "match" && query.keyframes.length) figures.push(`${query.keyframes.length} keyframes sent`);
    }
    const time = `${query.duration_ms.toFixed(1)} ms from receipt to the last reply.`;
    byId("query-figures").textContent = `${figures.join(", ")}. ${time}`;
    byId("query-fix").hidden = !query.fix;
    if (query.fix) byId("query-fix").textContent = fixText(query.fix);
    const candidates = query.candidates ?? [];
    byId("candidates").hidden = candidates.length === 0;
    byId("candidates").tBodies[0].replaceChildren(...candidates.flatMap((candidate) => candidateRows(candidate, () => this.onKeyframe(query.map, candidate.keyframe))));
  }
}

function fixText({ position, position_covariance: c, sigma_theta_rad: theta, inliers, matched_features: matched, mean_error_px: error }) {
  const sigma3 = 3 * Math.sqrt(Math.max((c[0][0] + c[1][1] + c[2][2]) / 3, 0));
  const place = position.map((value) => value.toFixed(2)).join(", ");
  const turn = ((3 * theta * 180) / Math.PI).toFixed(2);
  return `Camera at (${place}) m ± ${sigma3.toFixed(2)} m, ± ${turn}° (3σ): ${inliers} of ${matched} matched features agree, ${error.toFixed(1)} px.`;
}

function candidateRows(candidate, onKeyframe) {
  const [numbers, words] = [document.createElement("tr"), document.createElement("tr")];
  const isCompared = candidate.verdict !== "not_compared";
  const hasPose = candidate.mean_error_px !== null;
  const button = document.createElement("button");
  button.textContent = candidate.keyframe;
  button.title = "Show this keyframe";
  button.addEventListener("click", onKeyframe);
  cell(numbers, "").append(button);
  cell(numbers, candidate.votes);
  cell(numbers, isCompared ? candidate.matches : "–");
  cell(numbers, hasPose ? candidate.inliers : "–");
  cell(numbers, hasPose ? candidate.mean_error_px.toFixed(1) : "–");
  words.className = "verdict";
  const verdict = cell(words, `${VERDICTS[candidate.verdict]}${candidate.near_prior ? " (near the prior)" : ""}`);
  verdict.colSpan = 5;
  if (candidate.verdict === "in_answer") verdict.className = "good";
  else if (candidate.verdict.startsWith("no_") || candidate.verdict.startsWith("too_") || candidate.verdict === "pose_uncertain") verdict.className = "refused";
  return [numbers, words];
}
