// The list of robots, sorted by what its headings say.

import { drawIcon, STATES } from "./states.js";

const compare = (a, b) => (a < b ? -1 : a > b ? 1 : 0);

export class RobotList {
  constructor(body, headings, store, choose) {
    this.body = body;
    this.store = store;
    this.choose = choose;
    this.rows = new Map();
    this.sort = "state";
    this.headings = headings;
    this.order = "";
    for (const button of headings) {
      button.onclick = () => {
        this.sort = button.dataset.sort;
        for (const other of headings) {
          other.parentElement.setAttribute("aria-sort", other === button ? "ascending" : "none");
        }
        this.update();
      };
    }
  }

  /** Bring it up to date: cells that read the same are left alone. */
  update(palette = this.palette) {
    if (palette !== this.palette) for (const row of this.rows.values()) row.state = null;
    this.palette = palette;
    const { store } = this;
    const shown = store.shown().map((one) => ({
      ...one,
      error: one.pose?.error95_m ?? Infinity,
      age: store.past === null ? store.age(one.robot) : Infinity,
    }));
    const keys = {
      name: (one) => [one.name],
      state: (one) => [STATES[one.state].rank, one.name],
      error: (one) => [-one.error, one.name],
      age: (one) => [-Math.floor(one.age), one.name],
    };
    const key = keys[this.sort];
    shown.sort((a, b) => {
      const [left, right] = [key(a), key(b)];
      return compare(left[0], right[0]) || compare(left[1], right[1]);
    });
    for (const one of shown) this.#fill(this.#row(one.name), one);
    const order = shown.map(({ name }) => name).join("\n");
    if (order !== this.order) this.body.append(...shown.map(({ name }) => this.rows.get(name).element));
    this.order = order;
  }

  /** The same, but only where a state has changed or a robot is new: all else can wait. */
  turn(palette) {
    const turned = this.store.shown().some(({ name, state }) => this.rows.get(name)?.state !== state);
    if (turned || palette !== this.palette) this.update(palette);
  }

  #row(name) {
    if (this.rows.has(name)) return this.rows.get(name);
    const element = document.createElement("tr");
    const cells = ["th", "td", "td", "td"].map((kind) => element.appendChild(document.createElement(kind)));
    cells[0].scope = "row";
    const button = cells[0].appendChild(document.createElement("button"));
    button.textContent = button.title = name;
    element.onclick = () => this.choose(name);
    const icon = cells[1].appendChild(document.createElement("canvas"));
    icon.setAttribute("aria-hidden", "true");
    const word = cells[1].appendChild(document.createElement("span"));
    cells[2].className = cells[3].className = "number";
    element.dataset.robot = name;
    const row = { element, icon, word, error: cells[2], age: cells[3], state: null };
    this.rows.set(name, row);
    return row;
  }

  #fill(row, one) {
    const chosen = String(one.name === this.store.selected);
    if (row.element.getAttribute("aria-selected") !== chosen) row.element.setAttribute("aria-selected", chosen);
    if (row.state !== one.state) {
      row.state = one.state;
      row.element.dataset.state = one.state;
      drawIcon(row.icon, one.state, this.palette);
      row.word.textContent = STATES[one.state].word;
    }
    const texts = { error: metres(one.error), age: seconds(one.age) };
    for (const [cell, text] of Object.entries(texts)) {
      if (row[cell].textContent !== text) row[cell].textContent = text;
    }
  }
}

export function metres(value) {
  if (!Number.isFinite(value)) return "–";
  if (value < 1) return `${(100 * value).toFixed(1)} cm`;
  return value < 100 ? `${value.toFixed(2)} m` : `${Math.round(value)} m`;
}

export function seconds(value) {
  if (!Number.isFinite(value)) return "–";
  if (value < 10) return `${value.toFixed(1)} s`;
  if (value < 120) return `${Math.round(value)} s`;
  return value < 7200 ? `${Math.round(value / 60)} min` : `${Math.round(value / 3600)} h`;
}
