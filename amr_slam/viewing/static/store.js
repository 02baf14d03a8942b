// What the page knows of the robots, and whether it still hears anything.

import { History } from "./history.js";
import { PastScans } from "./past_scans.js";
import { STATES } from "./states.js";

const BLIND_MS = 1200; // twelve ticks: the server, or the way to it, has stopped

export class Store {
  constructor() {
    this.robots = new Map();
    this.history = new History(Object.keys(STATES));
    this.scans = new PastScans();
    this.selected = null;
    this.map = null; // UUID of the map that is shown
    this.link = { up: false, text: "connecting" };
    this.open = false; // the WebSocket
    this.right = "look";
    this.allowCommands = false;
    this.clock = 0; // server time less ours, s
    this.monotonic = 0; // its monotonic clock less performance.now(), s
    this.heard = -Infinity; // performance.now() of the newest tick
    this.past = null; // seconds before now that are looked at; null: live
  }

  now() {
    return Date.now() / 1000 + this.clock;
  }

  get blind() {
    return !this.open || performance.now() - this.heard > BLIND_MS;
  }

  hear(tick) {
    this.heard = performance.now();
    this.clock = tick.time_s - Date.now() / 1000;
    this.monotonic = tick.monotonic_s - this.heard / 1000;
    this.link = tick.link;
    for (const told of tick.robots) this.#tell(told);
    for (const status of tick.statuses) this.robot(status.robot).status = status;
    for (const { robot, map, points } of tick.scans) this.scans.push(robot, map, points, tick.time_s);
    for (const robot of this.robots.values()) {
      if (robot.pose) this.history.record(robot.robot, robot.state, robot.pose, tick.time_s);
    }
  }

  /** `posed`, `turned`: performance.now() when the newest pose came in, and when the state became
   * what it is; null where that was before this page was opened. */
  #tell(told) {
    const known = this.robots.get(told.robot)?.heard;
    const robot = this.robot(told.robot);
    if (told.pose && told.pose.seq !== robot.pose?.seq) robot.posed = this.heard;
    if (told.state !== robot.state || !known) robot.turned = known ? this.heard : null;
    Object.assign(robot, told, { heard: true });
  }

  robot(name) {
    if (!this.robots.has(name)) {
      this.robots.set(name, {
        robot: name, state: "absent", alive: false, pose: null, status: null, posed: null, turned: null,
      });
    }
    return this.robots.get(name);
  }

  /** The state to show: what nobody has told for a second is not shown as if it were so. */
  state(robot) {
    return this.blind && robot.state !== "absent" ? "stale" : robot.state;
  }

  /** Seconds since the wheel sample in the newest pose. */
  age(robot) {
    if (!robot.pose) return Infinity;
    const since = performance.now() / 1000 + this.monotonic - robot.pose.received_s;
    return robot.pose.age_s + Math.max(0, since);
  }

  /** All robots as they are, or were at the instant that is looked at: {robot, state, pose}. */
  shown() {
    if (this.past === null) {
      return [...this.robots.values()].map((robot) => ({
        robot, name: robot.robot, state: this.state(robot), pose: robot.pose,
      }));
    }
    const time = this.now() - this.past;
    return [...this.robots.values()].map((robot) => ({
      robot, name: robot.robot, pose: null, state: "absent",
      ...this.history.at(robot.robot, time),
    }));
  }

  /** Maps by the number of robots in them: [[uuid, name, version, names of robots], ...]. */
  maps() {
    const found = new Map();
    for (const robot of this.robots.values()) {
      const id = robot.pose?.map;
      if (!id) continue;
      if (!found.has(id)) found.set(id, { id, name: id.slice(0, 8), version: 0, robots: [] });
      const map = found.get(id);
      map.robots.push(robot);
      if (robot.status?.map?.id === id) {
        map.name = robot.status.map.name;
        map.version = Math.max(map.version, robot.status.map.version);
      }
    }
    return [...found.values()].sort((a, b) => b.robots.length - a.robots.length || (a.name < b.name ? -1 : 1));
  }
}
