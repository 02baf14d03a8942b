// The states of a robot: words, order, and the shape that stands for each beside its colour.

export const STATES = {
  localized: { word: "Localized", says: "Knows where it is.", rank: 8 },
  mapping: { word: "Mapping", says: "Knows where it is, and makes a map.", rank: 7 },
  odometry_only: { word: "Wheels only", says: "No fresh fix: the wheels carry the pose on.", rank: 6 },
  starting: { word: "Starting", says: "Has no pose yet.", rank: 5 },
  silent: { word: "Silent", says: "Is there, and has told no pose.", rank: 4 },
  ambiguous: { word: "Ambiguous", says: "Several places fit. Not to be driven by.", rank: 3 },
  lost: { word: "Lost", says: "Does not know where it is. Not to be driven by.", rank: 2 },
  stale: { word: "Stale", says: "Its poses have stopped. Not to be driven by.", rank: 1 },
  absent: { word: "Absent", says: "Not connected. Not to be driven by.", rank: 0 },
};

const polygon = (...points) => (path, r) => {
  points.forEach(([x, y], i) => (i ? path.lineTo(x * r, y * r) : path.moveTo(x * r, y * r)));
  path.closePath();
};
const circle = (k) => (path, r) => path.arc(0, 0, k * r, 0, 2 * Math.PI);
const ARROW = polygon([1.15, 0], [-0.85, 0.8], [-0.45, 0], [-0.85, -0.8]);

// Heading along +x. `body` is filled unless `hollow`; `dash` breaks the outline.
const SHAPES = {
  localized: { body: ARROW },
  mapping: { body: polygon([1.25, 0], [0.7, 0.75], [-0.8, 0.75], [-0.8, -0.75], [0.7, -0.75]) },
  odometry_only: { body: polygon([1.15, 0], [-0.8, 0.9], [-0.8, -0.9]), hollow: true },
  starting: { body: circle(0.75), hollow: true },
  ambiguous: { body: polygon([1.1, 0], [0, 0.85], [-1.1, 0], [0, -0.85]), mark: "?" },
  lost: { body: circle(0.9), mark: "×" },
  silent: { body: circle(0.75), hollow: true, dash: true },
  stale: { body: ARROW, hollow: true, dash: true },
  absent: { body: circle(0.55), hollow: true, dash: true },
};

/** Draw a state's glyph of radius `r` px at the context's origin, turned by `angle` on the screen. */
export function drawGlyph(ctx, state, angle, r, colour, ground) {
  const shape = SHAPES[state] ?? SHAPES.absent;
  ctx.save();
  ctx.rotate(angle);
  const path = new Path2D();
  shape.body(path, r);
  ctx.lineJoin = "round";
  ctx.strokeStyle = ground;
  ctx.lineWidth = 4;
  ctx.stroke(path);
  ctx.fillStyle = shape.hollow ? ground : colour;
  ctx.fill(path);
  ctx.strokeStyle = colour;
  ctx.lineWidth = shape.hollow ? 2.2 : 1;
  if (shape.dash) ctx.setLineDash([3, 2.4]);
  ctx.stroke(path);
  if (shape.mark) {
    ctx.rotate(-angle);
    ctx.fillStyle = ground;
    ctx.font = `700 ${Math.round(1.35 * r)}px system-ui, sans-serif`;
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    ctx.fillText(shape.mark, 0, 0.06 * r);
  }
  ctx.restore();
}

/** A small picture of the state, for lists. */
export function drawIcon(canvas, state, palette) {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = canvas.height = 20 * ratio;
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 10 * ratio, 10 * ratio);
  drawGlyph(ctx, state, -Math.PI / 2, 6.5, palette.states[state], palette.panel);
}
