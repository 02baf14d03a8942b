// The map: floor and walls, kept as a picture that is larger than the canvas while the view moves.

import { roundStep } from "./camera.js";
import { putText } from "./sprites.js";

const MARGIN = 1.5; // the picture's side over the canvas's
const SETTLED_MS = 90; // a view that still zooms stretches the old picture

export async function unpackMap(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const points = new Float32Array(buffer, 4 + length, 2 * header.points);
  const image = new Image();
  image.src = `data:image/png;base64,${header.floor.png}`;
  await image.decode();
  return { ...header, points, mask: maskOf(image, header.floor) };
}

/** White where floor was seen, clear elsewhere. */
function maskOf(image, floor) {
  const mask = new OffscreenCanvas(floor.columns, floor.rows);
  const ctx = mask.getContext("2d");
  ctx.drawImage(image, 0, 0);
  const pixels = ctx.getImageData(0, 0, floor.columns, floor.rows);
  const { data } = pixels;
  for (let i = 0; i < data.length; i += 4) {
    data[i + 3] = data[i] === floor.free || data[i] === 0 ? 255 : 0; // walls stand on floor
    data[i] = data[i + 1] = data[i + 2] = 255;
  }
  ctx.putImageData(pixels, 0, 0);
  return mask;
}

export class MapLayer {
  constructor() {
    this.map = null;
    this.picture = new OffscreenCanvas(1, 1);
    this.of = null;
    this.changed = 0;
  }

  set(map) {
    this.map = map;
    this.of = null;
  }

  /** Onto `ctx`; returns true where it wants to be drawn again soon. */
  draw(ctx, camera, palette, ratio) {
    if (!this.map) return false;
    const of = this.of;
    const stale = !of || of.palette !== palette || of.ratio !== ratio ||
      of.width !== camera.width || of.height !== camera.height;
    const zoomed = of && of.scale !== camera.scale;
    const away = of && Math.max(
      Math.abs(of.x - camera.x) * camera.scale / camera.width,
      Math.abs(of.y - camera.y) * camera.scale / camera.height,
    ) > (MARGIN - 1) / 2;
    if (zoomed && of.wanted !== camera.scale) {
      of.wanted = camera.scale;
      this.changed = performance.now();
    }
    const settled = performance.now() - this.changed > SETTLED_MS;
    if (stale || (zoomed && settled) || (away && !zoomed)) this.#render(camera, palette, ratio);
    const now = this.of;
    const k = camera.scale / now.scale;
    const [left, top] = camera.toScreen(now.x, now.y);
    const width = MARGIN * now.width * k;
    const height = MARGIN * now.height * k;
    ctx.drawImage(this.picture, left - width / 2, top - height / 2, width, height);
    return now.scale !== camera.scale;
  }

  #render(camera, palette, ratio) {
    const { map } = this;
    const width = MARGIN * camera.width;
    const height = MARGIN * camera.height;
    this.picture.width = Math.ceil(width * ratio);
    this.picture.height = Math.ceil(height * ratio);
    const ctx = this.picture.getContext("2d");
    const { scale } = camera;
    this.of = {
      x: camera.x, y: camera.y, scale, width: camera.width, height: camera.height, palette, ratio,
    };
    const ox = width / 2 - camera.x * scale;
    const oy = height / 2 + camera.y * scale;
    this.#floor(ctx, ox, oy, scale, palette, ratio, width, height);
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.fillStyle = palette.wall;
    const side = Math.max(map.cell_m * scale, 1.4);
    const { points } = map;
    for (let i = 0; i < points.length; i += 2) {
      const px = ox + points[i] * scale;
      const py = oy - points[i + 1] * scale;
      if (px > -side && py > -side && px < width + side && py < height + side) {
        ctx.fillRect(px - side / 2, py - side / 2, side, side);
      }
    }
  }

  #floor(ctx, ox, oy, scale, palette, ratio, width, height) {
    const { floor, mask } = this.map;
    const side = floor.cell_m * scale;
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.imageSmoothingEnabled = side < 6;
    ctx.drawImage(
      mask, ox + floor.x_min_m * scale, oy - (floor.y_min_m + floor.rows * floor.cell_m) * scale,
      floor.columns * side, floor.rows * side,
    );
    ctx.globalCompositeOperation = "source-in";
    ctx.fillStyle = palette.floor;
    ctx.fillRect(0, 0, width, height);
    ctx.globalCompositeOperation = "source-over";
  }
}

/** Lines every `step` m, every fifth stronger; the step is told by the scale bar. */
export function drawGrid(ctx, camera, palette) {
  const step = roundStep(90 / camera.scale);
  const [left, top] = camera.toMap(0, 0);
  const [right, bottom] = camera.toMap(camera.width, camera.height);
  ctx.strokeStyle = palette.grid;
  for (const strong of [false, true]) {
    ctx.globalAlpha = strong ? 1 : 0.5;
    ctx.lineWidth = 1;
    ctx.beginPath();
    for (let i = Math.ceil(left / step); i * step <= right; i += 1) {
      if ((i % 5 === 0) !== strong) continue;
      const px = Math.round(camera.toScreen(i * step, 0)[0]) + 0.5;
      ctx.moveTo(px, 0);
      ctx.lineTo(px, camera.height);
    }
    for (let i = Math.ceil(bottom / step); i * step <= top; i += 1) {
      if ((i % 5 === 0) !== strong) continue;
      const py = Math.round(camera.toScreen(0, i * step)[1]) + 0.5;
      ctx.moveTo(0, py);
      ctx.lineTo(camera.width, py);
    }
    ctx.stroke();
  }
  ctx.globalAlpha = 1;
  return step;
}

export function drawScaleBar(ctx, camera, palette, grid) {
  const length = roundStep(Math.min(160, camera.width / 3) / camera.scale);
  const px = length * camera.scale;
  const [x, y] = [20, camera.height - 22];
  const metres = (value) => (value < 1 ? `${+(100 * value).toPrecision(1)} cm` : `${value} m`);
  ctx.lineCap = "butt";
  for (const [width, colour] of [[6, palette.ground], [2.5, palette.ink]]) {
    ctx.strokeStyle = colour;
    ctx.lineWidth = width;
    ctx.beginPath();
    ctx.moveTo(x, y - 6);
    ctx.lineTo(x, y);
    ctx.lineTo(x + px, y);
    ctx.lineTo(x + px, y - 6);
    ctx.stroke();
  }
  drawText(ctx, metres(length), x + px / 2, y - 9, palette, { align: "center", size: 13, weight: 600 });
  drawText(ctx, `grid ${metres(grid)}`, x + px + 12, y + 1, palette, { size: 12, colour: palette.quiet });
}

const fontOf = (weight, size) => `${weight} ${size}px system-ui, -apple-system, "Segoe UI", Roboto, Inter, sans-serif`;

/** A text in the middle over (x, y) that comes again frame by frame. */
export function drawName(ctx, text, x, y, palette, size) {
  const style = { align: "center", size, weight: 600 };
  putText(ctx, text, fontOf(600, size), `${palette.ground}${palette.ink}`, x, y, (to) => drawText(to, text, 0, 0, palette, style));
}

/** Text with a halo, so that it is read on walls. */
export function drawText(ctx, text, x, y, palette, { align = "left", size = 13, weight = 500, colour, baseline = "alphabetic" } = {}) {
  ctx.font = fontOf(weight, size);
  ctx.textAlign = align;
  ctx.textBaseline = baseline;
  ctx.lineJoin = "round";
  ctx.lineWidth = 3.5;
  ctx.strokeStyle = palette.ground;
  ctx.strokeText(text, x, y);
  ctx.fillStyle = colour ?? palette.ink;
  ctx.fillText(text, x, y);
}
