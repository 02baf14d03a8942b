// The last ten minutes of each robot, in memory that does not grow.

export const SPAN_S = 600;
const PERIOD_S = 0.5;
const ROWS = 1500;
const MOST_MAPS = 256; // names come from the network
const FIELDS = ["x", "y", "theta", "xx", "xy", "yy", "error", "epoch", "map", "state"];
const FRESH_S = 1.5; // an older row says nothing of an instant

class Ring {
  constructor() {
    this.times = new Float64Array(ROWS);
    this.rows = new Float32Array(ROWS * FIELDS.length);
    this.count = 0;
  }

  push(time, values) {
    const at = this.count % ROWS;
    this.times[at] = time;
    this.rows.set(values, at * FIELDS.length);
    this.count += 1;
  }

  get first() {
    return Math.max(0, this.count - ROWS);
  }

  /** Number of the newest row that is not after `time`; -1 before the first. */
  find(time) {
    let low = this.first;
    let high = this.count - 1;
    if (high < low || this.times[low % ROWS] > time) return -1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle % ROWS] <= time) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  time(number) {
    return this.times[number % ROWS];
  }

  get(number, field) {
    return this.rows[(number % ROWS) * FIELDS.length + field];
  }
}

export const [X, Y, THETA, XX, XY, YY, ERROR, EPOCH, MAP, STATE] = FIELDS.keys();

export class History {
  constructor(states) {
    this.states = states;
    this.maps = [];
    this.rings = new Map();
    this.last = new Map();
  }

  /** Replace everything by what the server has kept. */
  load(buffer) {
    const length = new DataView(buffer).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
    this.maps = header.maps;
    this.rings.clear();
    this.last.clear();
    const width = header.columns.length;
    let values = new Float32Array(buffer, 4 + length);
    for (const { robot, rows } of header.robots) {
      const ring = new Ring();
      for (let i = 0; i < rows; i += 1) {
        const row = values.subarray(i * width + 1, (i + 1) * width);
        ring.push(header.begin_s + values[i * width], row);
      }
      this.rings.set(robot, ring);
      values = values.subarray(rows * width);
    }
  }

  /** Note where a robot is now: twice a second, and when its state changes. */
  record(name, state, pose, time) {
    const last = this.last.get(name);
    if (last && last.state === state && time - last.time < PERIOD_S) return;
    this.last.set(name, { state, time });
    if (!this.rings.has(name)) this.rings.set(name, new Ring());
    this.rings.get(name).push(time, [
      pose.x, pose.y, pose.theta, pose.xx, pose.xy, pose.yy, pose.error95_m ?? 1e9, pose.epoch,
      this.#numberOf(pose.map), this.states.indexOf(state),
    ]);
  }

  #numberOf(map) {
    if (map === null) return -1;
    if (!this.maps.includes(map) && this.maps.length < MOST_MAPS) this.maps.push(map);
    return this.maps.indexOf(map);
  }

  /** Where a robot was at an instant, as a robot of the present is told; null when nobody knows. */
  at(name, time) {
    const ring = this.rings.get(name);
    const number = ring ? ring.find(time) : -1;
    if (number < 0 || time - ring.time(number) > FRESH_S) return null;
    const get = (field) => ring.get(number, field);
    return {
      state: this.states[get(STATE)] ?? "absent",
      pose: {
        x: get(X), y: get(Y), theta: get(THETA), xx: get(XX), xy: get(XY), yy: get(YY),
        error95_m: get(ERROR) >= 1e9 ? null : get(ERROR), epoch: get(EPOCH),
        map: this.maps[get(MAP)] ?? null,
      },
    };
  }

  /** The way up to an instant, as pieces [[x, y], ...] without a jump or gap, oldest first; their
   * `epoch` is the newest row's, NaN where that is in another map. */
  trail(name, map, until, span) {
    const ring = this.rings.get(name);
    const end = ring ? ring.find(until) : -1;
    const pieces = [];
    let epoch = NaN;
    for (let i = end < 0 ? 1 : Math.max(ring.first, ring.find(until - span)); i <= end; i += 1) {
      const here = this.maps[ring.get(i, MAP)] === map;
      const gap = !pieces.length || ring.time(i) - ring.time(i - 1) > FRESH_S; // nobody knows the way
      if (here && (gap || ring.get(i, EPOCH) !== epoch)) pieces.push([]);
      epoch = here ? ring.get(i, EPOCH) : NaN;
      if (here) pieces.at(-1).push([ring.get(i, X), ring.get(i, Y)]);
    }
    pieces.epoch = epoch;
    return pieces;
  }

  /** A robot's states as [begin, end, state], oldest first. */
  stretches(name, begin) {
    const ring = this.rings.get(name);
    const found = [];
    for (let i = ring ? Math.max(ring.first, ring.find(begin)) : 0; ring && i < ring.count; i += 1) {
      const state = this.states[ring.get(i, STATE)];
      const last = found.at(-1);
      const gap = last && ring.time(i) - last[1] > FRESH_S;
      if (last && last[2] === state && !gap) last[1] = ring.time(i);
      else {
        if (last && !gap) last[1] = ring.time(i);
        found.push([ring.time(i), ring.time(i), state]);
      }
    }
    return found;
  }
}
