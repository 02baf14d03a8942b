// Which part of the map frame the canvas shows. Screen: CSS px, y down; map: m, y up.

const LEAST = 0.5; // px per m: 2 km over a screen
const MOST = 2000; // px per m

export class Camera {
  constructor() {
    this.x = 0;
    this.y = 0;
    this.scale = 20;
    this.width = 1;
    this.height = 1;
  }

  toScreen(x, y) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  toMap(px, py) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
  }

  /** What is under (px, py) stays there. */
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toMap(px, py);
    this.scale = Math.min(MOST, Math.max(LEAST, this.scale * factor));
    this.x = x - (px - this.width / 2) / this.scale;
    this.y = y + (py - this.height / 2) / this.scale;
  }

  fit([left, bottom, right, top]) {
    this.x = (left + right) / 2;
    this.y = (bottom + top) / 2;
    const margin = 1.12;
    const width = Math.max(right - left, 2) * margin;
    const height = Math.max(top - bottom, 2) * margin;
    this.scale = Math.min(MOST, Math.max(LEAST, Math.min(this.width / width, this.height / height)));
  }
}

/** 1, 2 or 5 times a power of ten: the largest that is not more than `most`. */
export function roundStep(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return [5, 2, 1].map((k) => k * power).find((step) => step <= most * 1.0001) ?? power;
}
