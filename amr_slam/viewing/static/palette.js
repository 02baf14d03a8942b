// The colours of the style sheet, for the canvas. Light and dark are the style sheet's affair.

import { STATES } from "./states.js";

const NAMES = ["ground", "panel", "ink", "quiet", "line", "accent", "floor", "wall", "scan", "grid", "layer", "new", "gone"];

export function readPalette() {
  const style = getComputedStyle(document.documentElement);
  const value = (name) => style.getPropertyValue(`--${name}`).trim();
  const palette = Object.fromEntries(NAMES.map((name) => [name, value(name)]));
  palette.states = Object.fromEntries(
    Object.keys(STATES).map((state) => [state, value(`state-${state.replace("_", "-")}`)]),
  );
  return palette;
}

export function onPaletteChange(act) {
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", act);
}
