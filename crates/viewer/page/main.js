// Loads the map, follows robots or shows a run, and handles keys and links.
import { Scene } from "./scene.js";
import { MapLayer } from "./map_layer.js";
import { Robot } from "./robot_layer.js";
import { Panel, STALE_S, stateOf } from "./panel.js";
import { followLive } from "./live.js";
import { Replay } from "./replay.js";
import { STATES, theme } from "./colors.js";

const byId = (id) => document.getElementById(id);
const chosenTheme = localStorage.getItem("theme");
const preferred = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
document.documentElement.dataset.theme = chosenTheme ?? preferred;

const scene = new Scene(byId("scene"));
const mapLayer = new MapLayer(scene);
const visible = {};
const robots = new Map();
const answersSeen = new Map();
const panel = new Panel((name) => follow(name));
let maps = [];
let shown = null;
let followed = null;
let replay = null;

// What the page shows, for tests and for the console.
window.driftless = { isReady: false, isConnected: false, map: null, counts: { keyframes: 0, landmarks: 0, robots: 0 }, robots: {} };

const link = () => new URLSearchParams(location.hash.slice(1));

function setLink(key, value) {
  const parameters = link();
  if (value) parameters.set(key, value);
  else parameters.delete(key);
  history.replaceState(null, "", `#${parameters}`);
}

async function json(path) {
  const response = await fetch(path);
  if (!response.ok) throw new Error(`${path}: ${response.status}`);
  return response.json();
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

async function showMap(name, isNew = true) {
  const map = maps.find((one) => one.name === name) ?? maps[0];
  if (!map) return;
  byId("map").value = map.name;
  const path = `api/maps/${encodeURIComponent(map.name)}`;
  const [{ keyframes }, response] = await Promise.all([json(`${path}/keyframes`), fetch(`${path}/landmarks`)]);
  const landmarks = new Float32Array(await response.arrayBuffer());
  const up = (map.gravity_in_global ?? [0, 0, -1]).map((value) => -value);
  shown = { name: map.name, version: map.version };
  scene.setUp(up);
  mapLayer.set(keyframes, landmarks, up);
  scene.setPoints(keyframes.map((keyframe) => keyframe.position));
  if (isNew) scene.fit();
  const drawn = landmarks.length / 3;
  const part = drawn < map.landmarks ? ` (${drawn.toLocaleString("en")} drawn)` : "";
  byId("summary").textContent =
    `Version ${map.version}, ${map.keyframes.toLocaleString("en")} keyframes, ${map.landmarks.toLocaleString("en")} landmarks${part}`;
  document.title = `${map.name} – Driftless`;
  window.driftless.map = shown;
  Object.assign(window.driftless.counts, { keyframes: keyframes.length, landmarks: drawn });
}

function robotOf(name) {
  let robot = robots.get(name);
  if (!robot) {
    robot = new Robot(scene, name, robots.size, visible);
    robots.set(name, robot);
    panel.add(name, robot.index);
    window.driftless.counts.robots = robots.size;
    if (link().get("robot") === name) follow(name);
  }
  return robot;
}

function onUpdate(update) {
  for (const published of update.robots) {
    const robot = robotOf(published.robot);
    const isNew = robot.received === undefined;
    if (robot.published?.is_online === false && published.is_online) robot.restartOdometry();
    robot.published = published;
    robot.received = performance.now();
    const { pose, odometry, answer } = published;
    // The pose in another map has no place in this one.
    const isHere = pose && (!shown || pose.map === shown.name);
    if (isHere) robot.setPose(pose.global_from_imu);
    else robot.position = null;
    if (odometry) robot.setOdometry(odometry.local_from_imu.position, isHere ? pose.global_from_local : null);
    if (answer && !isNew && answersSeen.get(published.robot) !== published.answers && answer.map === shown?.name) {
      robot.setAnswer(answer.keyframes.map((id) => mapLayer.keyframes.get(id)).filter(Boolean), robot.received);
    }
    answersSeen.set(published.robot, published.answers);
    window.driftless.robots[published.robot] = {
      position: robot.position, state: published.status?.state ?? null, reason: published.status?.reason ?? null,
      isOnline: published.is_online, answers: published.answers, trail: robot.trail.count,
    };
  }
  const version = update.maps?.[shown?.name];
  if (version !== undefined && version !== shown.version) reload(version);
}

async function reload(version) {
  notice(`The map changed to version ${version}.`);
  await loadMaps();
  await showMap(shown.name, false);
  setTimeout(() => notice(""), 8000);
}

function notice(text) {
  byId("notice").textContent = text;
  byId("notice").hidden = text === "";
}

function follow(name) {
  followed = followed === name ? null : name;
  panel.setFollowed(followed);
  setLink("robot", followed);
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  localStorage.setItem("theme", name);
  scene.applyTheme();
  mapLayer.applyTheme();
  robots.forEach((robot) => robot.applyTheme());
  panel.applyTheme();
  replay?.applyTheme();
}

const letGo = () => followed && follow(followed);
const ACTIONS = {
  fit: () => { letGo(); scene.fit(); },
  top: () => { letGo(); scene.top(); },
  theme: () => setTheme(theme() === "dark" ? "light" : "dark"),
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
  " ": () => replay?.toggle(),
  Escape: letGo,
};

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, input[type=range]")) return;
  const robot = [...robots.keys()][Number(event.key) - 1];
  if (/^[1-9]$/.test(event.key)) {
    if (robot) follow(robot);
  } else if (KEYS[event.key] && !(event.key === " " && event.target.closest("button"))) {
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
      if (box.dataset.layer === "truth" && replay) replay.truth.visible = box.checked;
    };
    box.addEventListener("change", apply);
    apply();
  }
  byId("map").addEventListener("change", (event) => {
    setLink("map", event.target.value);
    showMap(event.target.value);
  });
  window.addEventListener("keydown", onKey);
  window.addEventListener("hashchange", () => {
    const robot = link().get("robot");
    if (robot && robot !== followed && robots.has(robot)) follow(robot);
  });
}

function describe(robot, elapsed_s) {
  const { published } = robot;
  panel.update(published, elapsed_s);
  const sign = (STATES[stateOf(published)] ?? "").slice(0, 1);
  robot.setState(sign, !published.pose || published.pose.age_s + elapsed_s > STALE_S);
}

let last = performance.now();
let panelDue = 0;

function frame(now) {
  replay?.step((now - last) / 1000);
  last = now;
  const place = robots.get(followed)?.worldPosition();
  if (place) scene.follow(place);
  robots.forEach((robot) => robot.draw(now));
  if (now >= panelDue) {
    panelDue = now + 200;
    for (const robot of robots.values()) if (robot.published) describe(robot, (now - robot.received) / 1000);
  }
  scene.render();
  requestAnimationFrame(frame);
}

async function showRun() {
  const run = await json("api/run");
  byId("summary").textContent = `Run ${run.name}`;
  document.title = `${run.name} – Driftless`;
  scene.setUp(run.up);
  byId("robots").hidden = true;
  replay = new Replay(scene, run, robotOf(run.name));
  scene.setPoints(replay.points());
  scene.fit();
}

async function start() {
  bind();
  const { is_run: isRun } = await loadMaps();
  await showMap(link().get("map"));
  if (isRun) await showRun();
  else {
    if (!shown) scene.setPoints([]);
    followLive(onUpdate, (isConnected) => {
      window.driftless.isConnected = isConnected;
      byId("connection").textContent = isConnected ? "live" : "not connected";
    });
  }
  window.driftless.isReady = true;
  requestAnimationFrame(frame);
}

start().catch((error) => notice(`The map cannot be shown: ${error.message}`));
