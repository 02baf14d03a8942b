// What people have drawn over the map: zones without landmarks, erased areas, walls.

import { drawText } from "./map_layer.js";

const HATCH_PX = 9;

export function drawLayers(ctx, camera, layers, palette) {
  for (const { kind, name, points_m: points } of layers) {
    const path = new Path2D();
    points.forEach(([x, y], i) => {
      const [px, py] = camera.toScreen(x, y);
      if (i) path.lineTo(px, py);
      else path.moveTo(px, py);
    });
    ctx.strokeStyle = palette.layer;
    if (kind === "wall") {
      ctx.lineWidth = 3;
      ctx.stroke(path);
    } else {
      path.closePath();
      hatch(ctx, camera, path, points, kind === "zone" ? 1 : -1);
      ctx.setLineDash(kind === "zone" ? [8, 5] : [2, 4]);
      ctx.lineWidth = 1.6;
      ctx.stroke(path);
      ctx.setLineDash([]);
    }
    const [px, py] = camera.toScreen(...points[0]);
    const what = { zone: "no landmarks", erase: "erased", wall: "drawn" }[kind];
    drawText(ctx, `${name} (${what})`, px + 6, py - 6, palette, { size: 12, colour: palette.layer });
  }
}

/** Lines over a polygon, the way telling zones from erased areas. */
function hatch(ctx, camera, path, points, way) {
  const xs = points.map(([x, y]) => camera.toScreen(x, y)[0]);
  const ys = points.map(([x, y]) => camera.toScreen(x, y)[1]);
  const left = Math.max(0, Math.min(...xs));
  const right = Math.min(camera.width, Math.max(...xs));
  const top = Math.max(0, Math.min(...ys));
  const bottom = Math.min(camera.height, Math.max(...ys));
  if (left >= right || top >= bottom) return;
  ctx.save();
  ctx.clip(path);
  ctx.globalAlpha = 0.35;
  ctx.lineWidth = 1;
  ctx.beginPath();
  const height = bottom - top;
  for (let x = left - height; x < right + height; x += HATCH_PX) {
    ctx.moveTo(x, top);
    ctx.lineTo(x + way * height, bottom);
  }
  ctx.stroke();
  ctx.restore();
}
