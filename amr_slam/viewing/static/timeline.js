// The last ten minutes: the chosen robot's states as a strip, and a slider over them.

import { SPAN_S } from "./history.js";
import { STATES } from "./states.js";

export class Timeline {
  constructor({ strip, slider, when, live }, store, changed) {
    Object.assign(this, { strip, slider, when, live, store });
    const set = () => {
      const ago = -slider.valueAsNumber;
      store.past = ago > 0 ? ago : null;
      this.moment = store.past === null ? null : store.now() - ago;
      changed();
    };
    slider.oninput = set;
    live.onclick = () => {
      slider.value = 0;
      set();
    };
  }

  /** The instant that is looked at stays while now goes on, until it is ten minutes ago. */
  tick() {
    if (this.store.past === null) return;
    this.store.past = Math.min(SPAN_S, this.store.now() - this.moment);
    this.slider.value = -this.store.past;
  }

  update(palette) {
    const { store, strip } = this;
    const now = store.now();
    const text = store.past === null ? "now" : `${clock(now - store.past)}  ·  ${ago(store.past)} ago`;
    if (this.when.textContent !== text) this.when.textContent = text;
    this.live.setAttribute("aria-pressed", String(store.past === null));
    document.body.classList.toggle("past", store.past !== null);
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [strip.clientWidth, strip.clientHeight];
    strip.width = width * ratio;
    strip.height = height * ratio;
    const ctx = strip.getContext("2d");
    ctx.scale(ratio, ratio);
    const px = (time) => width * (1 - (now - time) / SPAN_S);
    const bar = { top: 6, height: height - 22 };
    ctx.fillStyle = palette.line;
    ctx.fillRect(0, bar.top, width, bar.height);
    for (const [begin, end, state] of this.#stretches(now)) {
      const left = Math.max(0, px(begin));
      ctx.fillStyle = palette.states[state];
      // Height tells the state, too: what is to be driven by is low.
      const k = STATES[state].rank >= 7 ? 0.45 : STATES[state].rank >= 5 ? 0.7 : 1;
      const right = now - end < 2 ? width : px(end); // still so
      ctx.fillRect(left, bar.top + (1 - k) * bar.height, Math.max(1, right - left), k * bar.height);
    }
    ctx.fillStyle = palette.quiet;
    ctx.font = "11px system-ui, sans-serif";
    for (let minute = 2; minute < 10; minute += 2) {
      ctx.textAlign = "center";
      ctx.fillText(`−${minute} min`, px(now - 60 * minute), height - 4);
    }
  }

  #stretches(now) {
    const { store } = this;
    return store.selected ? store.history.stretches(store.selected, now - SPAN_S) : [];
  }
}

const clock = (time) => new Date(1000 * time).toLocaleTimeString([], { hourCycle: "h23" });

function ago(seconds) {
  const whole = Math.round(seconds);
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)} min ${whole % 60} s`;
}
