// The page: what comes in goes to the store, what the store has is drawn.

import { ask, askToken } from "./actions.js";
import { Camera } from "./camera.js";
import { Changes } from "./changes.js";
import { Details } from "./details.js";
import { listen } from "./gestures.js";
import { Ground } from "./ground.js";
import { Link } from "./link.js";
import { RobotList } from "./list.js";
import { MapLayer, drawScaleBar } from "./map_layer.js";
import { Maps } from "./maps.js";
import { Measuring, Placing } from "./modes.js";
import { Notices } from "./notices.js";
import { onPaletteChange, readPalette } from "./palette.js";
import { drawScene, sceneOf } from "./scene.js";
import { Store } from "./store.js";
import { Timeline } from "./timeline.js";

const PANELS_MS = 250;
const SLOW_MS = 1000; // what nobody reads faster, and what costs more than it tells
const MOST_SCANS = 12;
const CHOOSE_PX = 24;

const $ = (id) => document.getElementById(id);
const canvas = $("canvas");
const store = new Store();
const camera = new Camera();
const layer = new MapLayer();
const ground = new Ground(layer);
const notices = new Notices($("notices"));
let palette = readPalette();
let mode = null;
let following = false;
let fitted = false;
let dirty = false; // a frame is asked for

const link = new Link({
  hello({ right, allow_commands: allowed, version }) {
    store.right = right;
    store.allowCommands = allowed;
    store.open = true;
    scansOf = "";
    document.documentElement.dataset.version = version;
    loadHistory();
  },
  tick(message) {
    store.hear(message);
    for (const text of message.notices) notices.say(text, text, { alarm: true });
    timeline.tick();
    if (message.robots.length || message.statuses.length || message.scans.length) touch();
  },
  closed() {
    store.open = false;
    touch();
  },
  refused() {
    if (!$("dialog").open) askToken($("dialog"), link, "This view shows the robots to those who have a token.");
  },
});

const maps = new Maps({
  store, link, layer, notices, choice: $("map-choice"), select: $("map"),
  shown(first) {
    if (first) fit();
    touch();
  },
});
const changes = new Changes({ store, link, notices, button: $("changes"), shown: touch });
const list = new RobotList($("robots"), [...document.querySelectorAll("th button")], store, choose);
const details = new Details($("details"), store, act);
const timeline = new Timeline({ strip: $("strip"), slider: $("time"), when: $("when"), live: $("live") }, store, refresh);
let scansOf = "";

async function loadHistory() {
  try {
    store.history.load(await link.bytes("/api/history"));
    touch();
  } catch (error) {
    notices.say("history", `The last minutes are not to be had: ${error.message}`);
  }
}

function fit() {
  const robots = store.shown().filter(({ pose }) => pose?.map === store.map).map(({ pose }) => pose);
  const xs = [...(layer.map ? [layer.map.bounds[0], layer.map.bounds[2]] : []), ...robots.map(({ x }) => x)];
  const ys = [...(layer.map ? [layer.map.bounds[1], layer.map.bounds[3]] : []), ...robots.map(({ y }) => y)];
  if (xs.length) camera.fit([Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)]);
  fitted = xs.length > 0;
  touch();
}

function choose(name) {
  store.selected = name;
  maps.show(store.robots.get(name)?.pose?.map);
  refresh();
}

function setMode(next) {
  mode = next;
  $("measure").setAttribute("aria-pressed", String(mode instanceof Measuring));
  $("mode").hidden = !mode;
  $("mode").textContent = mode?.says ?? "";
  canvas.classList.toggle("aims", Boolean(mode));
  touch();
}

function follow(on) {
  following = on;
  $("follow").setAttribute("aria-pressed", String(on));
  touch();
}

function act(key, name) {
  const robot = store.robots.get(name);
  if (key !== "set_pose") {
    ask($("dialog"), link, robot, key);
    return;
  }
  const pose = robot.pose ?? { x: camera.x, y: camera.y, theta: 0 };
  setMode(new Placing(name, pose.theta, (given) => {
    setMode(null);
    ask($("dialog"), link, robot, key, given);
  }));
  const numbers = document.createElement("button");
  numbers.textContent = "Type numbers instead";
  numbers.onclick = () => mode.done({ x: pose.x, y: pose.y, theta: pose.theta });
  $("mode").append(" ", numbers);
  canvas.focus();
}

listen(canvas, camera, {
  mode: () => mode,
  changed: touch,
  moved: () => follow(false),
  choose(px, py) {
    const near = store.shown().filter(({ pose }) => pose?.map === store.map).map(({ name, pose }) => {
      const [x, y] = camera.toScreen(pose.x, pose.y);
      return [Math.hypot(x - px, y - py), name];
    }).sort((a, b) => a[0] - b[0])[0];
    choose(near && near[0] < CHOOSE_PX ? near[1] : null);
  },
});

const keys = {
  "+": () => camera.zoom(1.3),
  "=": () => camera.zoom(1.3),
  "-": () => camera.zoom(1 / 1.3),
  0: fit,
  f: () => follow(!following),
  c: () => $("changes").click(),
  m: () => setMode(mode instanceof Measuring ? null : new Measuring()),
  l: () => $("live").click(),
  Escape: () => setMode(null),
};
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || $("dialog").open) return;
  if (event.target.matches("select, input")) return;
  keys[event.key]?.();
  touch();
});
$("zoom-in").onclick = keys["+"];
$("zoom-out").onclick = keys["-"];
$("fit").onclick = fit;
$("follow").onclick = keys.f;
$("measure").onclick = keys.m;
for (const id of ["zoom-in", "zoom-out"]) $(id).addEventListener("click", touch);
$("right").onclick = () => askToken($("dialog"), link, store.allowCommands
  ? "A token for commands lets this page command robots."
  : "This view was started without --allow-commands: a token changes nothing but who may look.");

let slow = -Infinity;
let blind = false;

function panels() {
  if (blind !== store.blind) touch(); // drawn so without a tick
  blind = store.blind;
  const up = store.link.up && !store.blind;
  const text = store.blind ? "no word from the view's server" : store.link.text;
  if ($("link").textContent !== text) $("link").textContent = text;
  $("link").dataset.kind = up ? "ok" : "alarm";
  if (store.blind && store.heard > 0) {
    notices.say("blind", "Nothing here is live: the view's server does not answer. Trying again.", { alarm: true, lasts: true });
  } else notices.end("blind");
  if (!store.blind && !store.link.up) {
    notices.say("link", `Nothing here is live: ${store.link.text}`, { alarm: true, lasts: true });
  } else notices.end("link");
  complain();
  $("right").textContent = store.right === "command" ? "Commands allowed" : "Looking only";
  $("right").dataset.kind = store.right === "command" ? "ok" : "";
  $("empty").hidden = store.robots.size > 0;
  $("empty").textContent = up ? "No robot is there yet." : "";
  maps.update();
  changes.update();
  list.turn(palette);
  details.update(palette);
  if (performance.now() - slow < SLOW_MS) return;
  slow = performance.now();
  touch(); // old scans go
  askForScans();
  list.update(palette);
  timeline.update(palette);
}

function complain() {
  for (const robot of store.robots.values()) {
    if (robot.refused > (robot.complained ?? 0)) {
      robot.complained = robot.refused;
      notices.say(`refused ${robot.robot}`, `${robot.robot}: ${robot.refused} messages under its name made no sense and were left out.`, { alarm: true });
    }
  }
}

/** The chosen robot's scans, and those of the others while there are few. */
function askForScans() {
  const here = [...store.robots.values()].filter(({ pose }) => pose?.map === store.map).map(({ robot }) => robot);
  const wanted = here.length <= MOST_SCANS ? here : here.filter((name) => name === store.selected);
  const text = JSON.stringify({ scans: wanted.sort() });
  if (text === scansOf || store.blind) return;
  scansOf = text;
  link.send({ scans: wanted });
}

function refresh() {
  touch();
  slow = -Infinity;
  panels();
}

/** Something to be seen has changed: the next frame shows it. */
function touch() {
  if (dirty) return;
  dirty = true;
  requestAnimationFrame(draw);
}

function draw() {
  dirty = false;
  const ratio = window.devicePixelRatio || 1;
  const begun = performance.now();
  if (following && store.selected) {
    const one = store.shown().find(({ name }) => name === store.selected);
    if (one?.pose && one.pose.map === store.map) [camera.x, camera.y] = [one.pose.x, one.pose.y];
  }
  const scene = sceneOf(store);
  if (!fitted && scene.shown.length && !layer.map) fit();
  const ctx = canvas.getContext("2d", { alpha: false });
  if (ground.draw(ctx, camera, palette, ratio, scene, changes.drawn)) touch();
  drawScene(ctx, camera, scene, palette, ground.until);
  mode?.draw(ctx, camera, palette);
  drawScaleBar(ctx, camera, palette, ground.grid);
  drawn.push(performance.now() - begun);
  if (drawn.length > 600) drawn.shift();
}
const drawn = []; // ms that the newest frames took

new ResizeObserver(() => {
  const ratio = window.devicePixelRatio || 1;
  camera.width = canvas.clientWidth;
  camera.height = canvas.clientHeight;
  canvas.width = Math.round(camera.width * ratio);
  canvas.height = Math.round(camera.height * ratio);
  touch();
}).observe(canvas);
onPaletteChange(() => {
  palette = readPalette();
  refresh();
});

window.amrSlam = { store, camera, layer, link, changes, choose, drawn, mode: () => mode }; // to be read in the console, and by tests
link.open();
setInterval(panels, PANELS_MS);
