// What moves on the map: trails, scans, error ellipses, robots, the places that a robot may be at.

import { drawText } from "./map_layer.js";
import { drawGlyph } from "./states.js";

const TRAIL_S = 60;
const MANY = 30; // robots: shorter trails, smaller glyphs, names of those that need a look
const MANY_TRAIL_S = 15;
const SCAN_MS = 6000; // three periods of a slow scanner: older says nothing of now
const ROOT_CHI2_95 = Math.sqrt(5.991); // two degrees of freedom
const SURE = new Set(["localized", "mapping"]);

export function drawScene(ctx, camera, store, palette) {
  const shown = store.shown().filter(({ pose }) => pose && pose.map === store.map);
  const many = shown.length > MANY;
  const until = store.now() - (store.past ?? 0);
  for (const one of shown) drawTrail(ctx, camera, store, one, palette, until, many);
  if (store.past === null) {
    for (const one of shown) drawScan(ctx, camera, store, one, palette);
    for (const one of shown) drawCandidates(ctx, camera, one, palette);
  }
  for (const one of shown) drawEllipse(ctx, camera, one, palette);
  // What needs a look lies on top.
  shown.sort((a, b) => (a.name === store.selected) - (b.name === store.selected) || SURE.has(b.state) - SURE.has(a.state));
  for (const one of shown) drawRobot(ctx, camera, store, one, palette, many);
  return shown;
}

function drawTrail(ctx, camera, store, { name, state, pose }, palette, until, many) {
  const chosen = name === store.selected;
  const pieces = store.history.trail(name, store.map, until, many && !chosen ? MANY_TRAIL_S : TRAIL_S);
  if (pieces.length) pieces.at(-1).push([pose.x, pose.y]);
  ctx.strokeStyle = palette.states[state];
  ctx.lineCap = ctx.lineJoin = "round";
  ctx.lineWidth = chosen ? 3 : 2;
  ctx.globalAlpha = chosen ? 0.75 : 0.4;
  ctx.beginPath();
  for (const piece of pieces) {
    piece.forEach(([x, y], i) => {
      const [px, py] = camera.toScreen(x, y);
      if (i) ctx.lineTo(px, py);
      else ctx.moveTo(px, py);
    });
  }
  ctx.stroke();
  ctx.globalAlpha = 1;
}

function drawScan(ctx, camera, store, { robot, state }, palette) {
  const { scan } = robot;
  if (!scan || scan.map !== store.map || performance.now() - scan.heard > SCAN_MS) return;
  const side = robot.robot === store.selected ? 3.4 : 2.6;
  ctx.fillStyle = palette.scan;
  ctx.globalAlpha = SURE.has(state) ? 0.9 : 0.5;
  for (const [x, y] of scan.points) {
    const [px, py] = camera.toScreen(x, y);
    ctx.fillRect(px - side / 2, py - side / 2, side, side);
  }
  ctx.globalAlpha = 1;
}

function drawEllipse(ctx, camera, { pose, state }, palette) {
  const { xx, xy, yy } = pose;
  const middle = (xx + yy) / 2;
  const spread = Math.hypot((xx - yy) / 2, xy);
  const axis = (variance) => Math.min(1e5, ROOT_CHI2_95 * Math.sqrt(Math.max(variance, 0)) * camera.scale);
  const [px, py] = camera.toScreen(pose.x, pose.y);
  ctx.beginPath();
  ctx.ellipse(px, py, axis(middle + spread), axis(middle - spread), -0.5 * Math.atan2(2 * xy, xx - yy), 0, 2 * Math.PI);
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
  const chosen = name === store.selected;
  const r = chosen ? 13 : many ? 8 : 11;
  ctx.save();
  ctx.translate(px, py);
  if (chosen) {
    ctx.beginPath();
    ctx.arc(0, 0, r + 8, 0, 2 * Math.PI);
    ctx.strokeStyle = palette.accent;
    ctx.lineWidth = 2;
    ctx.stroke();
  }
  drawGlyph(ctx, state, -pose.theta, r, palette.states[state], palette.ground);
  ctx.restore();
  if (!many || chosen || !SURE.has(state)) {
    const label = name.length > 24 ? `${name.slice(0, 23)}…` : name;
    drawText(ctx, label, px, py - r - (chosen ? 13 : 7), palette, { align: "center", size: chosen ? 15 : 13, weight: 600 });
  }
}
