// What has changed in the place since the map was made, as a robot in it has watched.

import { drawText } from "./map_layer.js";

const AGAIN_MS = 60000; // things come and go while their numbers stay
const AT_MOST_MS = 5000; // nor are they asked for more often
const LEAST_PX = 9; // of a box that is drawn
const WORDS_PX = 26; // a box this large has room for words; a few have it anyway
const FEW = 12;
const NONE = [];

export class Changes {
  constructor({ store, link, notices, button, shown }) {
    Object.assign(this, { store, link, notices, button, shown });
    this.on = true;
    this.list = NONE;
    this.of = ""; // whose list it is, and which
    this.map = null; // what it is of
    this.asked = -Infinity;
    this.asking = false;
    button.onclick = () => {
      this.on = !this.on;
      this.update();
      shown();
    };
  }

  /** Those to be drawn: of now, never over the past. */
  get drawn() {
    const here = this.map === this.store.map && this.store.past === null;
    return this.on && here ? this.list : NONE;
  }

  update() {
    const { store, button } = this;
    const robot = this.#whose();
    const counts = robot?.status.changes;
    button.hidden = !robot;
    button.setAttribute("aria-pressed", String(this.on));
    const text = robot ? `Changes (${counts.new + counts.gone})` : "Changes";
    if (button.textContent !== text) button.textContent = text;
    if (!this.on || store.blind || this.asking) return;
    const of = robot && counts.new + counts.gone ? [robot.robot, store.map, counts.new, counts.gone, counts.oldest_since].join(" ") : "";
    const since = performance.now() - this.asked;
    if (!of) this.#show(of, NONE);
    else if (since > AGAIN_MS || (of !== this.of && since > AT_MOST_MS)) this.#ask(robot, of);
  }

  /** The chosen robot's, else those of who has seen most of them. */
  #whose() {
    const { robots, map, selected } = this.store;
    const sees = [...robots.values()].filter(({ alive, pose, status }) => alive && pose?.map === map && status?.changes);
    const many = ({ status: { changes } }) => changes.new + changes.gone;
    return sees.find(({ robot }) => robot === selected) ?? sees.sort((a, b) => many(b) - many(a))[0];
  }

  async #ask(robot, of) {
    this.asking = true;
    this.asked = performance.now();
    try {
      const bytes = await this.link.bytes(`/api/changes?robot=${encodeURIComponent(robot.robot)}`);
      const { map, total, changes } = JSON.parse(new TextDecoder().decode(bytes));
      this.#show(of, map === this.store.map ? changes : NONE);
      this.notices.end("changes");
      if (total > changes.length) this.notices.say("changes", `${robot.robot} has seen ${total} changes: the largest ${changes.length} are drawn.`);
    } catch (error) {
      this.#show(of, NONE);
      this.notices.say("changes", `The changes are not to be had: ${error.message}`, { alarm: true });
    } finally {
      this.asking = false;
    }
  }

  #show(of, list) {
    if (of === this.of && list === this.list) return;
    Object.assign(this, { of, list, map: this.store.map });
    this.shown();
  }
}

/** New: a full box, filled; gone: a broken one, crossed out. Each with since when. */
export function drawChanges(ctx, camera, changes, palette) {
  for (const { number, what, box, since } of changes) {
    const [left, bottom] = camera.toScreen(box[0], box[1]);
    const [right, top] = camera.toScreen(box[2], box[3]);
    const width = Math.max(LEAST_PX, right - left);
    const height = Math.max(LEAST_PX, bottom - top);
    const [x, y] = [(left + right - width) / 2, (top + bottom - height) / 2];
    if (x > camera.width || y > camera.height || x + width < 0 || y + height < 0) continue;
    const colour = ctx.fillStyle = ctx.strokeStyle = palette[what];
    ctx.lineWidth = 2;
    ctx.beginPath();
    ctx.rect(x, y, width, height);
    if (what === "new") {
      ctx.globalAlpha = 0.25;
      ctx.fill();
      ctx.globalAlpha = 1;
      ctx.stroke();
    } else {
      ctx.setLineDash([5, 4]);
      ctx.stroke();
      ctx.setLineDash([]);
      ctx.beginPath();
      ctx.moveTo(x, y);
      ctx.lineTo(x + width, y + height);
      ctx.moveTo(x, y + height);
      ctx.lineTo(x + width, y);
      ctx.stroke();
    }
    if (changes.length > FEW && Math.max(width, height) < WORDS_PX) continue;
    const text = `${number} ${what}${since === null ? "" : ` since ${when(since)}`}`;
    drawText(ctx, text, x + width / 2, y + height + 15, palette, { align: "center", size: 12, weight: 600, colour });
  }
}

/** The time of a day that is today's, else the day. */
function when(seconds) {
  const date = new Date(1000 * seconds);
  const today = date.toDateString() === new Date().toDateString();
  return today
    ? date.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", hourCycle: "h23" })
    : date.toLocaleDateString([], { day: "numeric", month: "short", year: "numeric" });
}
