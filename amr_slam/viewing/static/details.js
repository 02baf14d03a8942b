// The chosen robot in words and numbers, and what can be done with it.

import { ACTIONS } from "./actions.js";
import { metres, seconds } from "./list.js";
import { drawIcon, STATES } from "./states.js";

const degrees = (radians) => `${((180 / Math.PI) * radians).toFixed(1)}°`;
const OLD = new Set(["absent", "stale"]);
const LINKS = { OK: ["●", "ok"], STALE: ["▲", "warn"], LOST: ["✕", "alarm"] };

function make(kind, className, text = "") {
  const element = document.createElement(kind);
  if (className) element.className = className;
  element.textContent = text;
  return element;
}

export class Details {
  constructor(place, store, act) {
    this.place = place;
    this.store = store;
    this.icon = make("canvas");
    this.name = make("h2");
    this.says = make("p", "says");
    this.faults = make("div", "faults");
    this.numbers = make("dl");
    this.health = make("ul", "health");
    const head = make("div", "head");
    const words = make("div");
    words.append(this.name, this.says);
    head.append(this.icon, words);
    this.actions = make("div", "actions");
    this.why = make("p", "why");
    this.buttons = Object.entries(ACTIONS).map(([key, { label }]) => {
      const button = make("button", "", label);
      button.dataset.action = key;
      button.onclick = () => act(key, store.selected);
      return button;
    });
    this.actions.append(...this.buttons);
    this.place.append(head, this.faults, this.numbers, this.health, this.actions, this.why);
  }

  update(palette) {
    const { store } = this;
    const robot = store.robots.get(store.selected);
    this.place.hidden = !robot;
    if (!robot) return;
    const one = store.shown().find(({ name }) => name === store.selected);
    const live = store.past === null;
    const fresh = live && !OLD.has(one.state); // else what it told last is no word on now
    if (this.drawn !== `${one.state}${palette.ink}`) {
      this.drawn = `${one.state}${palette.ink}`;
      drawIcon(this.icon, one.state, palette);
    }
    this.place.dataset.state = one.state;
    this.#text(this.name, robot.robot);
    this.#text(this.says, `${STATES[one.state].word}. ${STATES[one.state].says}`);
    this.#lines(this.faults, "p", live ? this.#complaints(robot, fresh) : [], (line, text) => this.#text(line, text));
    this.#lines(this.numbers, "div", this.#values(robot, one.pose, live, fresh), (line, [name, value]) => {
      if (!line.children.length) line.append(make("dt"), make("dd"));
      this.#text(line.children[0], name);
      this.#text(line.children[1], value);
    });
    this.#lines(this.health, "li", fresh ? parts(robot) : [], (line, [name, part]) => this.#part(line, name, part));
    const why = this.#whyNot(live);
    for (const button of this.buttons) button.disabled = Boolean(why);
    this.#text(this.why, why);
  }

  #whyNot(live) {
    if (!live) return "This is the past. Back to live to do something.";
    if (this.store.blind) return "The view's server does not answer.";
    if (this.store.right === "command") return "";
    if (this.store.allowCommands) return "Looking only: commands need a token for commands.";
    return "Looking only: this view was started without --allow-commands.";
  }

  #complaints(robot, fresh) {
    const status = robot.status ?? {};
    const said = fresh ? [robot.pose?.fault, status.fault, status.advice].filter(Boolean) : [];
    if (robot.refused) said.push(`${robot.refused} of its messages made no sense`);
    return [...new Set(said)];
  }

  #values(robot, pose, live, fresh) {
    if (!pose) return [["Pose", "none yet"]];
    const values = [
      ["x, y", `${pose.x.toFixed(3)}, ${pose.y.toFixed(3)} m`],
      ["Heading", degrees(pose.theta)],
      ["Error, 95 %", metres(pose.error95_m ?? Infinity)],
    ];
    if (live) values.push(["Pose age", seconds(this.store.age(robot))]);
    if (live && !this.store.blind && robot.turned !== null) {
      values.push(["In this state for", seconds((performance.now() - robot.turned) / 1000)]);
    }
    if (!fresh) return values;
    const { explained, changes } = robot.status ?? {};
    const seen = changes ? [["Changes seen", `${changes.new} new, ${changes.gone} gone`]] : [];
    return [
      ...values,
      ["Since a fix", seconds(pose.since_fix_s ?? Infinity)],
      ["Speed", `${pose.vx.toFixed(2)} m/s, ${degrees(pose.omega)}/s`],
      ["Scan on walls", explained == null ? "–" : `${Math.round(100 * explained)} %`],
      ["Map", robot.status?.map ? `${robot.status.map.name}, version ${robot.status.map.version}` : "–"],
      ["Mode", robot.status?.mode ?? "–"],
      ...seen,
    ];
  }

  #part(line, name, part) {
    if (!line.children.length) line.append(make("i"), make("b"), make("span"));
    const [sign, kind] = LINKS[part.link];
    const [mark, title, rest] = line.children;
    line.className = kind;
    this.#text(mark, sign);
    this.#text(title, name);
    const age = part.age_s === null ? "no data yet" : `${part.rate_hz.toFixed(1)} Hz`;
    const link = part.link === "OK" ? age : `${part.link.toLowerCase()}, ${seconds(part.age_s ?? Infinity)}`;
    this.#text(rest, part.detail ? `${link} – ${part.detail}` : link);
  }

  /** As many children of a kind as there are values, each filled with its own. */
  #lines(place, kind, values, fill) {
    while (place.children.length > values.length) place.lastChild.remove();
    while (place.children.length < values.length) place.append(make(kind));
    values.forEach((value, i) => fill(place.children[i], value));
  }

  #text(element, text) {
    if (element.textContent !== text) element.textContent = text;
  }
}

function parts(robot) {
  const { status } = robot;
  return status ? [...Object.entries(status.scanners), ["wheels", status.wheels], ["slam", status.slam]] : [];
}
