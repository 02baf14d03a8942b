// The ways that robots have come.

const TRAIL_S = 60;
const MANY_TRAIL_S = 15; // of those that are not chosen, where there are many robots

/** Seconds of its way that are shown. */
export const trailSpan = (chosen, many) => (many && !chosen ? MANY_TRAIL_S : TRAIL_S);

/** The last `span` seconds of a robot's way until `until`; with `pose`, on to there. */
export function drawTrail(ctx, camera, { store, selected }, { name, state }, palette, until, span, pose = null) {
  const pieces = store.history.trail(name, store.map, until, span);
  if (pose && pieces.epoch === pose.epoch) pieces.at(-1)?.push([pose.x, pose.y]);
  if (!pieces.length) return;
  const chosen = name === selected;
  ctx.strokeStyle = palette.states[state];
  ctx.lineCap = "butt";
  ctx.lineJoin = "round";
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
