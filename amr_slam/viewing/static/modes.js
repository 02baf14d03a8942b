// What a press on the map means beside moving it: measuring, and setting a pose.

import { drawText } from "./map_layer.js";

const degrees = (radians) => `${((180 / Math.PI) * radians).toFixed(1)}°`;

/** Distance and angle between two points; a third begins anew. */
export class Measuring {
  says = "Measure: press two points, or drag from one to the other. Enter takes the middle of the map, Esc ends.";

  constructor() {
    this.from = this.to = null;
    this.open = false;
  }

  press(point) {
    if (this.open) this.to = point;
    else [this.from, this.to] = [point, point];
    this.open = !this.open;
  }

  hover(point) {
    if (this.open) this.to = point;
  }

  release(point, dragged) {
    if (this.open && dragged) {
      this.to = point;
      this.open = false;
    }
  }

  draw(ctx, camera, palette) {
    if (!this.from) return;
    const [ax, ay] = camera.toScreen(...this.from);
    const [bx, by] = camera.toScreen(...this.to);
    ctx.strokeStyle = ctx.fillStyle = palette.accent;
    ctx.lineWidth = 2.5;
    ctx.beginPath();
    ctx.moveTo(ax, ay);
    ctx.lineTo(bx, by);
    ctx.stroke();
    for (const [x, y] of [[ax, ay], [bx, by]]) {
      ctx.beginPath();
      ctx.arc(x, y, 4.5, 0, 2 * Math.PI);
      ctx.fill();
    }
    drawText(ctx, this.text, (ax + bx) / 2, (ay + by) / 2 - 12, palette, { align: "center", size: 15, weight: 650, colour: palette.accent });
  }

  get text() {
    if (!this.from) return "";
    const [dx, dy] = [this.to[0] - this.from[0], this.to[1] - this.from[1]];
    return `${Math.hypot(dx, dy).toFixed(3)} m   ${degrees(Math.atan2(dy, dx))}`;
  }
}

/** Press where the robot is, drag to where it looks. `done` gets {x, y, theta}. */
export class Placing {
  constructor(robot, theta, done) {
    this.says = `Press where ${robot} is, and drag towards where it looks. Esc ends.`;
    this.theta = theta;
    this.done = done;
    this.at = null;
  }

  press(point) {
    this.at = point;
    this.to = point;
  }

  hover(point, down) {
    if (!this.at || !down) return;
    this.to = point;
  }

  release(point, dragged) {
    if (!this.at) return;
    this.to = point;
    if (dragged) this.theta = Math.atan2(point[1] - this.at[1], point[0] - this.at[0]);
    this.done({ x: this.at[0], y: this.at[1], theta: this.theta });
  }

  draw(ctx, camera, palette) {
    if (!this.at) return;
    const [px, py] = camera.toScreen(...this.at);
    const [qx, qy] = camera.toScreen(...this.to);
    const far = Math.hypot(qx - px, qy - py) > 6;
    const angle = far ? Math.atan2(qy - py, qx - px) : -this.theta;
    ctx.save();
    ctx.translate(px, py);
    ctx.rotate(angle);
    ctx.strokeStyle = ctx.fillStyle = palette.accent;
    ctx.lineWidth = 3;
    ctx.beginPath();
    ctx.arc(0, 0, 12, 0, 2 * Math.PI);
    ctx.moveTo(12, 0);
    ctx.lineTo(52, 0);
    ctx.stroke();
    ctx.beginPath();
    ctx.moveTo(64, 0);
    ctx.lineTo(50, 7);
    ctx.lineTo(50, -7);
    ctx.fill();
    ctx.restore();
  }
}
