// The page: what comes in goes to the store, what the store has is drawn.

import { ask, askToken } from "./actions.js";
import { Camera } from "./camera.js";
import { Details } from "./details.js";
import { listen } from "./gestures.js";
import { drawLayers } from "./layers.js";
import { Link } from "./link.js";
import { RobotList } from "./list.js";
import { MapLayer, drawGrid, drawScaleBar } from "./map_layer.js";
import { Maps } from "./maps.js";
import { Measuring, Placing } from "./modes.js";
import { Notices } from "./notices.js";
import { onPaletteChange, readPalette } from "./palette.js";
import { drawScene } from "./scene.js";
import { Store } from "./store.js";
import { Timeline } from "./timeline.js";

const PANELS_MS = 250;
const MOST_SCANS = 12;
const CHOOSE_PX = 24;

const $ = (id) => document.getElementById(id);
const canvas = $("canvas");
const store = new Store();
const camera = new Camera();
const layer = new MapLayer();
const notices = new Notices($("notices"));
let palette = readPalette();
let mode = null;
let following = false;
let fitted = false;
let dirty = true;

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
    dirty = true;
  },
  closed() {
    store.open = false;
    dirty = true;
  },
  refused() {
    if (!$("dialog").open) askToken($("dialog"), link, "This view shows the robots to those who have a token.");
  },
});

const maps = new Maps({
  store, link, layer, notices, choice: $("map-choice"), select: $("map"),
  shown(first) {
    if (first) fit();
    dirty = true;
  },
});
const list = new RobotList($("robots"), [...document.querySelectorAll("th button")], store, choose);
const details = new Details($("details"), store, act);
const timeline = new Timeline({ strip: $("strip"), slider: $("time"), when: $("when"), live: $("live") }, store, refresh);
let scansOf = "";

async function loadHistory() {
  try {
    store.history.load(await link.bytes("/api/history"));
    dirty = true;
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
  dirty = true;
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
  dirty = true;
}

function follow(on) {
  following = on;
  $("follow").setAttribute("aria-pressed", String(on));
  dirty = true;
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
  changed: () => { dirty = true; },
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
  m: () => setMode(mode instanceof Measuring ? null : new Measuring()),
  l: () => $("live").click(),
  Escape: () => setMode(null),
};
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || $("dialog").open) return;
  if (event.target.matches("select, input")) return;
  keys[event.key]?.();
  dirty = true;
});
$("zoom-in").onclick = keys["+"];
$("zoom-out").onclick = keys["-"];
$("fit").onclick = fit;
$("follow").onclick = keys.f;
$("measure").onclick = keys.m;
for (const id of ["zoom-in", "zoom-out"]) $(id).addEventListener("click", () => { dirty = true; });
$("right").onclick = () => askToken($("dialog"), link, store.allowCommands
  ? "A token for commands lets this page command robots."
  : "This view was started without --allow-commands: a token changes nothing but who may look.");

function panels() {
  dirty = true; // what has grown stale, or blind, is drawn so without a tick
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
  askForScans();
  list.update(palette);
  details.update(palette);
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
  dirty = true;
  panels();
}

function draw() {
  requestAnimationFrame(draw);
  if (!dirty) return;
  dirty = false;
  const ratio = window.devicePixelRatio || 1;
  const begun = performance.now();
  if (following && store.selected) {
    const one = store.shown().find(({ name }) => name === store.selected);
    if (one?.pose && one.pose.map === store.map) [camera.x, camera.y] = [one.pose.x, one.pose.y];
  }
  const ctx = canvas.getContext("2d", { alpha: false });
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.fillStyle = palette.ground;
  ctx.fillRect(0, 0, camera.width, camera.height);
  dirty = layer.draw(ctx, camera, palette, ratio);
  const grid = drawGrid(ctx, camera, palette);
  drawLayers(ctx, camera, layer.map?.layers ?? [], palette);
  const shown = drawScene(ctx, camera, store, palette);
  if (!fitted && shown.length && !layer.map) fit();
  mode?.draw(ctx, camera, palette);
  drawScaleBar(ctx, camera, palette, grid);
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
  dirty = true;
}).observe(canvas);
onPaletteChange(() => {
  palette = readPalette();
  refresh();
});

window.amrSlam = { store, camera, layer, link, choose, drawn, mode: () => mode }; // to be read in the console, and by tests
link.open();
setInterval(panels, PANELS_MS);
draw();
