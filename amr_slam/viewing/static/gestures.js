// Fingers, mouse and keys on the map.

const CLICK_PX = 5;
const STEP_PX = 60;

/**
 * `on`: {mode(): the mode at work or null, changed(), choose(px, py), moved()}.
 * One finger moves the map or does what the mode says, two zoom it.
 */
export function listen(canvas, camera, on) {
  const down = new Map();
  let start = null;
  let dragged = false;
  const at = (event) => [event.offsetX, event.offsetY];
  const map = (event) => camera.toMap(...at(event));

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, at(event));
    start = at(event);
    dragged = down.size > 1;
    if (down.size === 1) on.mode()?.press(map(event));
    on.changed();
  });

  canvas.addEventListener("pointermove", (event) => {
    const before = down.get(event.pointerId);
    const mode = on.mode();
    if (before && down.size === 2) pinch(event, before);
    else if (before && start) {
      dragged ||= Math.hypot(at(event)[0] - start[0], at(event)[1] - start[1]) > CLICK_PX;
      if (!mode && dragged) {
        camera.pan(at(event)[0] - before[0], at(event)[1] - before[1]);
        on.moved();
      }
    }
    if (before) down.set(event.pointerId, at(event));
    mode?.hover(map(event), down.size === 1);
    if (before || mode) on.changed();
  });

  function pinch(event, before) {
    const other = [...down.entries()].find(([id]) => id !== event.pointerId)[1];
    const now = at(event);
    const middle = [(now[0] + other[0]) / 2, (now[1] + other[1]) / 2];
    const apart = (point) => Math.max(1, Math.hypot(point[0] - other[0], point[1] - other[1]));
    camera.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
    camera.zoom(apart(now) / apart(before), ...middle);
    on.moved();
  }

  canvas.addEventListener("pointerup", (event) => {
    if (!down.delete(event.pointerId) || !start) return;
    const mode = on.mode();
    if (mode) mode.release(map(event), dragged);
    else if (!dragged) on.choose(...at(event));
    if (down.size === 0) start = null;
    on.changed();
  });
  canvas.addEventListener("pointercancel", (event) => down.delete(event.pointerId));

  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 16 : 1;
    camera.zoom(Math.exp(-0.0015 * lines * event.deltaY), ...at(event));
    on.changed();
  }, { passive: false });

  canvas.addEventListener("keydown", (event) => {
    const pans = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    if (pans[event.key]) {
      camera.pan(...pans[event.key].map((k) => k * STEP_PX));
      on.moved();
    } else if (event.key === "Enter" && on.mode()) {
      const middle = camera.toMap(camera.width / 2, camera.height / 2);
      on.mode().press(middle);
      on.mode().release(middle, false);
    } else return;
    event.preventDefault();
    on.changed();
  });
}
