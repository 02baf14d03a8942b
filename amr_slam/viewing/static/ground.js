// What lies under the robots, as pictures that are painted only when they have changed: map, grid
// and what people drew; and over these the trails, a second old at most. Ten times a second one of
// them is copied.

import { drawChanges } from "./changes.js";
import { drawLayers } from "./layers.js";
import { drawGrid } from "./map_layer.js";
import { drawTrail, trailSpan } from "./trails.js";

const TRAILS_S = 1;

const same = (a, b) => a !== null && a.length === b.length && a.every((value, i) => value === b[i]);

class Picture {
  constructor() {
    this.canvas = new OffscreenCanvas(1, 1);
    this.ctx = this.canvas.getContext("2d", { alpha: false });
    this.of = null; // what it was painted for
  }

  /** Ready to be painted, as large as the screen's. */
  begin({ width, height }, ratio) {
    // Nothing is copied from a picture without pixels.
    const [columns, rows] = [width, height].map((side) => Math.max(1, Math.round(side * ratio)));
    if (this.canvas.width !== columns) this.canvas.width = columns;
    if (this.canvas.height !== rows) this.canvas.height = rows;
    this.ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    return this.ctx;
  }
}

export class Ground {
  constructor(layer) {
    this.layer = layer;
    this.still = new Picture();
    this.trailed = new Picture();
    this.until = 0; // the trails in it end here, server's seconds
    this.grid = 1;
  }

  /** Onto the whole of `ctx`. Returns true where it wants to be drawn again soon. */
  draw(ctx, camera, palette, ratio, scene, changes) {
    const view = [camera.x, camera.y, camera.scale, camera.width, camera.height, ratio, palette];
    const still = [...view, this.layer.map, changes];
    const moved = !same(this.still.of, still);
    const again = moved && this.#paintStill(still, camera, palette, ratio);
    const trails = [scene.store.map, scene.selected, scene.live, scene.many];
    const age = scene.until - this.until;
    if (moved || !same(this.trailed.of, trails) || Math.abs(age) > TRAILS_S) {
      this.#paintTrails(trails, camera, palette, ratio, scene);
    }
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.drawImage(this.trailed.canvas, 0, 0);
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    return again;
  }

  #paintStill(of, camera, palette, ratio) {
    const ctx = this.still.begin(camera, ratio);
    ctx.fillStyle = palette.ground;
    ctx.fillRect(0, 0, camera.width, camera.height);
    const again = this.layer.draw(ctx, camera, palette, ratio);
    this.grid = drawGrid(ctx, camera, palette);
    drawLayers(ctx, camera, this.layer.map?.layers ?? [], palette);
    drawChanges(ctx, camera, of.at(-1), palette);
    this.still.of = again ? null : of;
    return again;
  }

  #paintTrails(of, camera, palette, ratio, scene) {
    const ctx = this.trailed.begin(camera, ratio);
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.drawImage(this.still.canvas, 0, 0);
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    for (const one of scene.shown) {
      drawTrail(ctx, camera, scene, one, palette, scene.until, trailSpan(one.name === scene.selected, scene.many));
    }
    this.until = scene.until;
    this.trailed.of = of;
  }
}
