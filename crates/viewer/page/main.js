// Loads the map, follows robots or shows a run, and handles keys and links.
import { Scene } from "./scene.js";
import { MapLayer } from "./map_layer.js";
import { Changes } from "./changes_layer.js";
import { Robot } from "./robot_layer.js";
import { Panel } from "./panel.js";
import { Fleet, SILENT_S, alarmOf, stateOf } from "./presence.js";
import { keysOf } from "./names.js";
import { load } from "./load.js";
import { followLive } from "./live.js";
import { Replay } from "./replay.js";
import { History, clockText, linkOfTime, timeOfLink } from "./history.js";
import { Queries } from "./queries.js";
import { ImageQuery } from "./image_query.js";
import { QueryLayer } from "./query_layer.js";
import { ServerChart } from "./server_chart.js";
import { Tabs } from "./tabs.js";
import { KeyframeDialog, pickKeyframes, pixelOf } from "./keyframe_dialog.js";
import { STATES, theme } from "./colors.js";

const byId = (id) => document.getElementById(id);
const chosenTheme = localStorage.getItem("theme");
const preferred = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
document.documentElement.dataset.theme = chosenTheme ?? preferred;

const scene = new Scene(byId("scene"));
const mapLayer = new MapLayer(scene);
const changes = new Changes(scene);
const keyframeDialog = new KeyframeDialog();
const visible = {};
const robots = new Map();
const answersSeen = new Map();
const panel = new Panel((name) => follow(name));
const fleet = new Fleet((name) => name !== followed && follow(name));
let keys = new Map();
let maps = [];
let shown = null;
let followed = null;
let replay = null;
// Only where robots are live:
let past = null;
let queries = null;
let queryLayer = null;
let serverChart = null;
let tabs = null;
let imageQuery = null;

// So many landmarks are loaded: 12 MB.
const LANDMARKS = 1000000;

const DESCRIBE_MS = 200;
// Robots are told of 20 times a second: 30 pictures show all of it at half the work of 60. A millisecond less than two of 60 take.
const FRAME_MS = 1000 / 30 - 1;
// Without a change, nor a hand on the page, there is a picture this often.
const IDLE_MS = 250;
// Where there are more robots, only those with an alarm have their names in the map.
const MOST_LABELS = 40;
// A server begins to search images some time after it has shown its map.
const OFFER_MS = 3000;

// What the page shows, and where no panel covers the map; for tests and for the console.
window.driftless = { isReady: false, isConnected: false, map: null, counts: { keyframes: 0, landmarks: 0, robots: 0 }, robots: {}, layers: {}, time: { isLive: true, t: null }, free: () => scene.free, pixelOf: (id) => pixelOf(scene, mapLayer.keyframes.get(id).position) };

const link = () => new URLSearchParams(location.hash.slice(1));

function setLink(key, value) {
  const parameters = link();
  if (value) parameters.set(key, value);
  else parameters.delete(key);
  history.replaceState(null, "", `#${parameters}`);
}

async function json(path) {
  const response = await fetch(path);
  if (response.ok) return response.json();
  const { error } = await response.json().catch(() => ({}));
  throw new Error(error ?? `${path}: ${response.status}`);
}

async function loadMaps() {
  const list = await json("api/maps");
  maps = list.maps;
  const select = byId("map");
  select.replaceChildren(...maps.map(({ name }) => new Option(name, name)));
  select.disabled = maps.length < 2;
  select.hidden = maps.length === 0;
  return list;
}

// The map that was chosen last, which may still be loading, and how many were.
let wanted = null;
let loads = 0;

// Shows a map, unless another one is chosen before it is loaded.
async function showMap(name, isNew = true) {
  const map = maps.find((one) => one.name === name) ?? maps[0];
  if (!map) return;
  loads += 1;
  const number = loads;
  wanted = map.name;
  byId("map").value = map.name;
  const path = `api/maps/${encodeURIComponent(map.name)}`;
  let loaded;
  try {
    loaded = await Promise.all([json(`${path}/keyframes`), load(`${path}/landmarks?limit=${LANDMARKS}`)]);
  } catch (error) {
    if (number !== loads) return;
    wanted = shown?.name ?? wanted;
    byId("map").value = wanted;
    throw error;
  }
  if (number !== loads) return;
  const [{ keyframes }, response] = loaded;
  const landmarks = new Float32Array(response);
  const up = (map.gravity_in_global ?? [0, 0, -1]).map((value) => -value);
  const isOther = shown?.name !== map.name;
  shown = { name: map.name, version: map.version, revision: map.revision, changes: isOther ? undefined : shown.changes };
  scene.setUp(up);
  mapLayer.set(keyframes, landmarks, up);
  scene.setPoints(keyframes.map((keyframe) => keyframe.position));
  if (isNew) scene.fit();
  if (isOther && past) leaveMap();
  const drawn = landmarks.length / 3;
  const cells = map.cells ? `, ${map.cells.here} of ${map.cells.all} cells` : "";
  byId("summary").textContent =
    `Version ${map.version}${cells}, ${counted(map.keyframes, keyframes.length)} keyframes, ${counted(map.landmarks, drawn)} landmarks`;
  document.title = `${map.name} – Driftless`;
  window.driftless.map = shown;
  Object.assign(window.driftless.counts, { keyframes: keyframes.length, landmarks: drawn });
  await showChanges();
}

// Trails and odometry that were drawn are in the frame of the former map.
function leaveMap() {
  past.forget();
  for (const robot of robots.values()) {
    robot.leaveMap();
    if (past.isLive && robot.published) showPublished(robot, true);
  }
}

// What changed since the release before, and what an open candidate would change.
async function showChanges() {
  const { name } = shown;
  const answer = await json(`api/maps/${encodeURIComponent(name)}/changes`);
  // Another map, or another version of it, may be shown by now.
  if (shown.name !== name) return;
  window.driftless.layers = changes.set(answer.version === shown.version ? answer : null, mapLayer.size);
  isChanged = true;
}

// A number, and how many of them are drawn where these are fewer.
function counted(all, drawn) {
  const text = (count) => count.toLocaleString("en");
  return drawn < all ? `${text(all)} (${text(drawn)} drawn)` : text(all);
}

function robotOf(name) {
  let robot = robots.get(name);
  if (!robot) {
    robot = new Robot(scene, name, visible);
    robots.set(name, robot);
    panel.add(name);
    keys = keysOf(robots.keys());
    panel.setKeys(keys);
    panel.isSorted = false;
    queries?.addRobot(name);
    window.driftless.counts.robots = robots.size;
    if (link().get("robot") === name || (!shown && !replay && !followed)) follow(name);
  }
  return robot;
}

// The process of the server that the page was told by.
let instance = null;

function onUpdate(update) {
  isChanged ||= update.robots.length > 0;
  // What the page knows of queries is of another process, or of another time.
  const isRestarted = update.is_snapshot && instance !== null && update.instance !== instance;
  if (update.is_snapshot) instance = update.instance;
  const isClockSet = past.note(update);
  if (isRestarted || isClockSet) queries.restart();
  for (const published of update.robots) {
    const robot = robotOf(published.robot);
    const { published: before } = robot;
    if (before?.has_ended && !published.has_ended) robot.restartOdometry();
    robot.published = published;
    robot.received = performance.now();
    if (past.isLive) showPublished(robot, before === undefined);
  }
  if (update.run) offerSwitch();
  const [version, revision] = [update.maps?.[shown?.name], update.revisions?.[shown?.name]];
  if (isRestarted) {
    // Both begin anew, and may be those of the former process.
    if (shown) Object.assign(shown, { revision: null, changes: undefined });
    reload("The map server was started again.");
  } else if (revision !== undefined && revision !== shown.revision) {
    reload(version === shown.version ? "Other cells of the map are here." : `The map changed to version ${version}.`);
  }
  const known = update.changes?.[shown?.name];
  if (known !== undefined && known !== shown.changes) {
    shown.changes = known;
    showChanges().catch((error) => notice(`The changes of the map cannot be shown: ${error.message}`));
  }
  if (!isLinkRead) readTimeOfLink();
}

// Shows a robot as it is now.
function showPublished(robot, isNew) {
  const { published } = robot;
  const { pose, odometry, answer } = published;
  // The pose in another map has no place in this one.
  const isHere = pose && (!shown || pose.map === shown.name);
  if (isHere) robot.setPose(pose.global_from_imu);
  else if (!shown && odometry) robot.setPose(odometry.local_from_imu);
  else robot.position = null;
  if (odometry) robot.setOdometry(odometry.local_from_imu.position, isHere ? pose.global_from_local : null);
  if (answer && !isNew && answersSeen.get(robot.name) !== published.answers && answer.map === shown?.name) {
    robot.setAnswer(answer.keyframes.map((id) => mapLayer.keyframes.get(id)).filter(Boolean), robot.received);
  }
  answersSeen.set(robot.name, published.answers);
  window.driftless.robots[robot.name] = {
    position: robot.position, state: published.status?.state ?? null, reason: published.status?.reason ?? null,
    isOnline: published.is_online, answers: published.answers, trail: robot.trail.count,
  };
}

// `t`: the time that is shown, null for the present.
function onTime(t) {
  for (const robot of robots.values()) {
    if (t === null && robot.published) showPublished(robot, true);
    if (t === null) continue;
    window.driftless.robots[robot.name] = { position: robot.position, state: robot.past?.status?.state ?? null };
  }
  window.driftless.time = { isLive: t === null, t };
  queries.setUntil(t);
  serverChart.setUntil(t);
  describeAll();
}

// The map's history.
async function loadHistory() {
  return json(`api/history${shown ? `?map=${encodeURIComponent(shown.name)}` : ""}`);
}

let isLinkRead = false;

function readTimeOfLink() {
  isLinkRead = true;
  const t = timeOfLink(link().get("t") ?? "");
  if (Number.isFinite(t)) past.seek(t);
}

// Loads the map again that is shown, or was chosen since.
async function reload(text) {
  notice(text);
  try {
    await loadMaps();
    await showMap(wanted ?? link().get("map"), wanted !== shown?.name || mapLayer.keyframes.size === 0);
    await past?.refresh();
    await offerImages();
  } catch (error) {
    notice(`The map cannot be shown: ${error.message}`);
    return;
  }
  setTimeout(() => byId("notice").textContent === text && notice(""), 8000);
}

// Shows a map that somebody chose.
async function chooseMap(name) {
  notice("");
  try {
    await showMap(name);
    if (wanted !== name) return;
    setLink("map", name);
    await past?.refresh();
    if (imageQuery) await offerImages();
  } catch (error) {
    notice(`The map ${name} cannot be shown: ${error.message}`);
  }
}

function notice(text) {
  byId("notice").textContent = text;
  byId("notice").hidden = text === "";
}

function follow(name) {
  followed = followed === name ? null : name;
  panel.setFollowed(followed);
  queries?.setRobot(followed);
  setLink("robot", followed);
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  localStorage.setItem("theme", name);
  scene.applyTheme();
  mapLayer.applyTheme();
  changes.applyTheme();
  robots.forEach((robot) => robot.applyTheme());
  panel.applyTheme();
  replay?.applyTheme();
  queryLayer?.applyTheme();
  serverChart?.draw();
}

// Asked again now and then: a server may begin to search images after it has shown its map.
async function offerImages() {
  const { takes_images: isOffered } = await json("api/maps");
  await imageQuery.offer(isOffered);
}

// A run that has ended is shown as a whole, or as it was seen.
function offerSwitch() {
  const isRun = replay !== null;
  byId("switch").textContent = isRun ? "Robots and queries" : "Show the whole run";
  if (byId("switch").hidden && !isRun) notice("The run has ended.");
  byId("switch").hidden = false;
}

function switchView() {
  if (byId("switch").hidden) return;
  setLink("view", replay ? "live" : null);
  for (const key of ["t", "tab", "robot"]) setLink(key, null);
  location.reload();
}

const letGo = () => followed && follow(followed);
const ACTIONS = {
  fit: () => { letGo(); scene.fit(); },
  top: () => { letGo(); scene.top(); },
  theme: () => setTheme(theme() === "dark" ? "light" : "dark"),
  legend: () => {
    const isOpen = document.documentElement.classList.toggle("has-legend");
    byId("legend-button").setAttribute("aria-expanded", isOpen);
  },
  image: () => {
    tabs?.choose("queries");
    if (imageQuery?.isOffered) byId("image-file").focus();
  },
  help: () => (byId("help").open ? byId("help").close() : byId("help").showModal()),
};

function toggleLayer(name) {
  document.querySelector(`[data-layer="${name}"]`).click();
}

const KEYS = {
  f: ACTIONS.fit,
  t: ACTIONS.top,
  d: ACTIONS.theme,
  "?": ACTIONS.help,
  o: () => toggleLayer("odometry"),
  e: () => toggleLayer("ellipsoids"),
  r: () => tabs?.choose("robots"),
  q: () => tabs?.choose("queries"),
  s: () => tabs?.choose("server"),
  l: () => past?.goLive(),
  i: ACTIONS.image,
  v: switchView,
  " ": () => (past ?? replay?.timeline)?.toggle(),
  Escape: letGo,
};

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, textarea")) return;
  if (event.target.closest("input[type=range]") && /^(Arrow|Page|Home|End)/.test(event.key)) return;
  const robot = [...keys].find(([, key]) => key === Number(event.key))?.[0];
  if (/^[1-9]$/.test(event.key)) {
    if (robot) follow(robot);
  } else if (KEYS[event.key] && !(event.key === " " && event.target.closest("button, input:not([type=range])"))) {
    event.preventDefault();
    KEYS[event.key]();
  }
}

function bind() {
  for (const button of document.querySelectorAll("[data-action]")) {
    button.addEventListener("click", () => ACTIONS[button.dataset.action]());
  }
  for (const box of document.querySelectorAll("[data-layer]")) {
    const apply = () => {
      visible[box.dataset.layer] = box.checked;
      mapLayer.show(box.dataset.layer, box.checked);
      changes.show(box.dataset.layer, box.checked);
      if (box.dataset.layer === "truth" && replay) replay.truth.visible = box.checked;
    };
    box.addEventListener("change", apply);
    apply();
  }
  byId("map").addEventListener("change", (event) => chooseMap(event.target.value));
  byId("switch").addEventListener("click", switchView);
  pickKeyframes(scene, byId("scene"), () => (visible.keyframes ? mapLayer.keyframes.values() : []), showKeyframe);
  window.addEventListener("keydown", onKey);
  for (const kind of ["keydown", "input", "click", "resize"]) window.addEventListener(kind, () => (isChanged = true));
  window.addEventListener("hashchange", () => {
    const robot = link().get("robot");
    if (robot && robot !== followed && robots.has(robot)) follow(robot);
    if (past) readTimeOfLink();
  });
}

function describe(robot, now) {
  const isPast = past && !past.isLive;
  if (!isPast && !robot.published) return null;
  const published = isPast ? robot.past ?? { robot: robot.name, state: "nothing", heard_age_s: 0 } : robot.published;
  const elapsed_s = isPast ? 0 : (now - robot.received) / 1000;
  const state = isPast ? published.state : stateOf(published, elapsed_s, window.driftless.isConnected);
  panel.update(published, state, elapsed_s, robot.heading(scene.up));
  robot.setState(state, (STATES[state] ?? "").slice(0, 1), !published.pose || published.pose.age_s + elapsed_s > SILENT_S);
  const alarm = isPast ? null : alarmOf(state, published, elapsed_s);
  robot.isLabelled = robots.size <= MOST_LABELS || alarm !== null || robot.name === followed;
  return { name: robot.name, state, alarm };
}

// Also while nothing is drawn.
function describeAll() {
  const now = performance.now();
  fleet.show([...robots.values()].map((robot) => describe(robot, now)).filter(Boolean));
  if (!panel.isSorted) panel.sort();
  panel.isSorted = true;
}

let last = performance.now();
let drawn = 0;
// Whether something happened since the last picture.
let isChanged = true;

function frame(now) {
  requestAnimationFrame(frame);
  if (now - last < FRAME_MS) return;
  replay?.timeline.step((now - last) / 1000);
  past?.frame((now - last) / 1000);
  last = now;
  const place = robots.get(followed)?.worldPosition();
  if (place) scene.follow(place);
  const isMoving = scene.advance() || (past ?? replay)?.timeline.isPlaying;
  if (!isMoving && !isChanged && now - drawn < IDLE_MS) return;
  isChanged = false;
  drawn = now;
  robots.forEach((robot) => robot.draw(now));
  scene.render();
}

async function showRun() {
  const run = await json("api/run");
  byId("summary").textContent = `Run ${run.name}`;
  document.title = `${run.name} – Driftless`;
  scene.setUp(run.up);
  byId("side").hidden = true;
  replay = new Replay(scene, run, robotOf(run.name), (t) => setLink("t", t.toFixed(1)));
  scene.setPoints(replay.points());
  scene.fit();
  const t = Number(link().get("t") ?? NaN);
  if (Number.isFinite(t)) replay.timeline.seek(t);
}

// A keyframe of the map that is shown.
function showKeyframe(keyframe) {
  const map = maps.find(({ name }) => name === shown.name);
  if (map) keyframeDialog.show(map, keyframe);
}

// A candidate of a query, where its map is shown.
function showCandidate(map, id) {
  const keyframe = map === shown?.name ? mapLayer.keyframes.get(id) : null;
  if (keyframe) showKeyframe(keyframe);
}

// The candidates of a query in the map that is shown.
function showQuery(query) {
  const isHere = query && query.map === shown?.name;
  const place = ({ keyframe, verdict }) => ({ keyframe: mapLayer.keyframes.get(keyframe), isUsed: verdict === "in_answer" });
  const candidates = isHere ? (query.candidates ?? []).map(place).filter(({ keyframe }) => keyframe) : [];
  const fix = isHere ? query.fix ?? null : null;
  const from = fix?.position ?? query?.camera_in_global ?? query?.prior_in_global ?? null;
  queryLayer.set(from, candidates, mapLayer.size ?? 0.3, fix);
  window.driftless.query = query && {
    number: query.number, kind: query.kind, outcome: query.outcome ?? query.error, drawn: candidates.length, camera: fix?.position ?? null,
  };
}

// What was found out about an image that was given to the page.
function showImage(query) {
  past?.goLive();
  queries.pin(query);
  const place = query.fix?.position;
  if (!place) return;
  letGo();
  scene.moveTo(place);
}

// Robots in their odometry frames, whose z axis points upwards.
function showNoMap() {
  byId("summary").textContent = "No map: robots are drawn in their odometry frame L.";
  scene.setUp([0, 0, 1]);
  scene.setPoints([]);
  scene.fit();
}

// Of a stored map there is nothing to come, but images can be localized in it.
function showStored() {
  document.documentElement.classList.add("is-stored");
  tabs = null;
  queryLayer = new QueryLayer(scene);
  queries = new Queries(showQuery, showCandidate);
  imageQuery = new ImageQuery({ mapName: () => shown?.name ?? null, onGiven: () => {}, onAnswer: showImage });
  byId("robots").hidden = true;
  byId("queries").hidden = false;
  byId("no-queries").textContent = "No image yet.";
  byId("side").setAttribute("aria-label", "Images");
  queries.setOpen(true);
  setInterval(() => offerImages().catch(() => {}), OFFER_MS);
  offerImages().catch(() => {});
}

function showLive() {
  past = new History({
    load: loadHistory,
    robotNames: () => [...robots.keys()],
    robotOf,
    onShown: onTime,
    onSettle: (t) => setLink("t", t === null ? null : linkOfTime(t)),
    onError: (error) => notice(`The past cannot be shown: ${error.message}`),
  });
  queryLayer = new QueryLayer(scene);
  queries = new Queries(showQuery, showCandidate);
  imageQuery = new ImageQuery({
    mapName: () => shown?.name ?? null,
    onGiven: () => tabs.choose("queries"),
    onAnswer: showImage,
  });
  serverChart = new ServerChart();
  tabs = new Tabs((name) => {
    queries.setOpen(name === "queries");
    if (name === "queries") offerImages().catch(() => {});
    serverChart.setOpen(name === "server");
    setLink("tab", name === "robots" ? null : name);
  }, link().get("tab"));
  followLive(onUpdate, (isConnected) => {
    const isNew = window.driftless.isConnected !== isConnected;
    window.driftless.isConnected = isConnected;
    byId("connection").textContent = isConnected ? "online" : "offline";
    if (isNew && !isConnected) byId("offline").textContent = `No connection to the map server since ${clockText(past.now())}: how the robots are is not known.`;
    byId("offline").hidden = isConnected || past.offset === null;
    describeAll();
  });
  setInterval(describeAll, DESCRIBE_MS);
}

async function start() {
  bind();
  const { is_run: isRun, is_live: isLive } = await loadMaps();
  await showMap(link().get("map"));
  if (isRun && !(isLive && link().get("view") === "live")) {
    await showRun();
    if (isLive) offerSwitch();
  } else {
    if (!shown) showNoMap();
    if (isLive) showLive();
    else showStored();
  }
  window.driftless.isReady = true;
  requestAnimationFrame(frame);
}

start().catch((error) => notice(`The map cannot be shown: ${error.message}`));
