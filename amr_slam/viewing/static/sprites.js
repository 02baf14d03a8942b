// Glyphs and words that are drawn again and again, painted once: stroking a halo costs a hundred
// times what copying its pixels does.

const MOST = 3000; // beyond it all are painted anew
const TURNS = 96; // headings of a painted glyph: less than half a pixel off at its tip

const painted = new Map();
const measure = new OffscreenCanvas(1, 1).getContext("2d");

/** The picture under a key, `width` by `height` px around its origin at (left, top). */
function sprite(key, ratio, size, paint) {
  let found = painted.get(key);
  if (found) return found;
  if (painted.size >= MOST) painted.clear();
  const { width, height, left, top } = size();
  const canvas = new OffscreenCanvas(Math.ceil(width * ratio), Math.ceil(height * ratio));
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, left * ratio, top * ratio);
  paint(ctx);
  found = { canvas, left, top, width: canvas.width / ratio, height: canvas.height / ratio };
  painted.set(key, found);
  return found;
}

/** Onto whole pixels of the screen: they are copied, not blended. */
function put(ctx, { canvas, left, top, width, height }, x, y, ratio) {
  const whole = (value) => Math.round(value * ratio) / ratio;
  ctx.drawImage(canvas, whole(x - left), whole(y - top), width, height);
}

/** What `paint(ctx, angle)` draws within `reach` px of its origin, turned to the nearest angle that is kept. */
export function putTurned(ctx, key, angle, reach, x, y, paint) {
  const ratio = ctx.getTransform().a;
  const turn = Math.round((angle / (2 * Math.PI)) * TURNS);
  const step = ((turn % TURNS) + TURNS) % TURNS;
  const size = () => ({ width: 2 * reach, height: 2 * reach, left: reach, top: reach });
  const one = sprite(`${key}|${step}|${ratio}`, ratio, size, (to) => paint(to, (step / TURNS) * 2 * Math.PI));
  put(ctx, one, x, y, ratio);
}

/** What `paint(ctx)` writes in `font` around its origin: in the middle of it, on its base line. */
export function putText(ctx, text, font, colours, x, y, paint) {
  const ratio = ctx.getTransform().a;
  const one = sprite(`${text}|${font}|${colours}|${ratio}`, ratio, () => {
    measure.font = font;
    const { width, actualBoundingBoxAscent: up, actualBoundingBoxDescent: down } = measure.measureText(text);
    return { width: width + 8, height: up + down + 8, left: width / 2 + 4, top: up + 4 };
  }, paint);
  put(ctx, one, x, y, ratio);
}
