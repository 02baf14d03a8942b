// What moves on the map: scans, error ellipses, robots, the places that a robot may be at.

import { drawName, drawText } from "./map_layer.js";
import { putTurned } from "./sprites.js";
import { drawGlyph } from "./states.js";
import { drawTrail } from "./trails.js";

const MANY = 30; // robots: shorter trails, smaller glyphs, names of those that need a look
const ROOT_CHI2_95 = Math.sqrt(5.991); // two degrees of freedom
const SURE = new Set(["localized", "mapping"]);
const NAME_PX = 150; // half of the longest name, and its height
const UNDER_GLYPH = 0.4; // of a glyph's radius: what is smaller lies wholly under it

/** The robots on the map that is shown, and the instant for which they are so (server's seconds). */
export function sceneOf(store) {
  const shown = store.shown().filter(({ pose }) => pose && pose.map === store.map);
  // What needs a look lies on top.
  const { selected } = store;
  shown.sort((a, b) => (a.name === selected) - (b.name === selected) || SURE.has(b.state) - SURE.has(a.state));
  return {
    store, shown, selected, many: shown.length > MANY, live: store.past === null,
    until: store.now() - (store.past ?? 0),
  };
}

/** `since`: the trails on the ground end then. */
export function drawScene(ctx, camera, scene, palette, since) {
  const { store, shown, live, many, until } = scene;
  for (const one of shown) drawTrail(ctx, camera, scene, one, palette, until, Math.max(0, until - since), one.pose);
  for (const one of shown) drawScan(ctx, camera, scene, one, palette);
  if (live) {
    for (const one of shown) drawCandidates(ctx, camera, one, palette);
  }
  for (const one of shown) drawEllipse(ctx, camera, scene, one, palette);
  for (const one of shown) drawRobot(ctx, camera, store, one, palette, many);
}

const radius = (chosen, many) => (chosen ? 13 : many ? 8 : 11);

function isOn(camera, px, py, reach) {
  return px > -reach && py > -reach && px < camera.width + reach && py < camera.height + reach;
}

function drawScan(ctx, camera, { store, selected, until }, { name, state }, palette) {
  const points = store.scans.at(name, store.map, until);
  if (!points) return;
  const side = name === selected ? 3.4 : 2.6;
  ctx.fillStyle = palette.scan;
  ctx.globalAlpha = SURE.has(state) ? 0.9 : 0.5;
  for (let i = 0; i < points.length; i += 2) {
    const [px, py] = camera.toScreen(points[i], points[i + 1]);
    ctx.fillRect(px - side / 2, py - side / 2, side, side);
  }
  ctx.globalAlpha = 1;
}

function drawEllipse(ctx, camera, { selected, many }, { name, pose, state }, palette) {
  const { xx, xy, yy } = pose;
  const middle = (xx + yy) / 2;
  const spread = Math.hypot((xx - yy) / 2, xy);
  const axis = (variance) => Math.min(1e5, ROOT_CHI2_95 * Math.sqrt(Math.max(variance, 0)) * camera.scale);
  const [px, py] = camera.toScreen(pose.x, pose.y);
  const longest = axis(middle + spread);
  if (longest < UNDER_GLYPH * radius(name === selected, many) || !isOn(camera, px, py, longest)) return;
  ctx.beginPath();
  ctx.ellipse(px, py, longest, axis(middle - spread), -0.5 * Math.atan2(2 * xy, xx - yy), 0, 2 * Math.PI);
  ctx.fillStyle = ctx.strokeStyle = palette.states[state];
  ctx.globalAlpha = 0.16;
  ctx.fill();
  ctx.globalAlpha = 0.9;
  ctx.lineWidth = 1.5;
  ctx.stroke();
  ctx.globalAlpha = 1;
}

function drawCandidates(ctx, camera, { robot, state, pose }, palette) {
  const candidates = robot.status?.candidates ?? [];
  if (state !== "ambiguous") return;
  const from = camera.toScreen(pose.x, pose.y);
  const colour = palette.states.ambiguous;
  for (const place of candidates) {
    const [px, py] = camera.toScreen(place.x, place.y);
    drawText(ctx, `${Math.round(100 * place.odds)} % here`, px, py + 28, palette, { align: "center", colour, weight: 600 });
    if (Math.hypot(px - from[0], py - from[1]) < 12) continue; // where the pose is
    ctx.strokeStyle = colour;
    ctx.lineWidth = 1.5;
    ctx.setLineDash([6, 5]);
    ctx.beginPath();
    ctx.moveTo(...from);
    ctx.lineTo(px, py);
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.save();
    ctx.translate(px, py);
    ctx.globalAlpha = 0.55;
    drawGlyph(ctx, "ambiguous", -place.theta, 11, colour, palette.ground);
    ctx.restore();
  }
}

function drawRobot(ctx, camera, store, { name, state, pose }, palette, many) {
  const [px, py] = camera.toScreen(pose.x, pose.y);
  if (!isOn(camera, px, py, NAME_PX)) return;
  const chosen = name === store.selected;
  const r = radius(chosen, many);
  if (chosen) {
    ctx.beginPath();
    ctx.arc(px, py, r + 8, 0, 2 * Math.PI);
    ctx.strokeStyle = palette.accent;
    ctx.lineWidth = 2;
    ctx.stroke();
  }
  const colour = palette.states[state];
  putTurned(ctx, `${state}|${r}|${colour}`, -pose.theta, 1.3 * r + 3, px, py, (to, angle) => {
    drawGlyph(to, state, angle, r, colour, palette.ground);
  });
  if (!many || chosen || !SURE.has(state)) {
    const label = name.length > 24 ? `${name.slice(0, 23)}…` : name;
    drawName(ctx, label, px, py - r - (chosen ? 13 : 7), palette, chosen ? 15 : 13);
  }
}
