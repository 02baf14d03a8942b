// Which map is shown, and the newest version of it.

import { unpackMap } from "./map_layer.js";

const GROWING_MS = 5000; // a map that grows is not asked for more often
const AGAIN_MS = 10000; // nor one that could not be had

export class Maps {
  constructor({ store, link, layer, notices, choice, select, shown }) {
    Object.assign(this, { store, link, layer, notices, choice, select, shown });
    this.have = "";
    this.next = 0;
    this.loading = false;
    select.onchange = () => this.show(select.value);
  }

  show(id) {
    if (!id || id === this.store.map) return;
    this.store.map = id;
    this.layer.set(null);
    this.have = "";
    this.next = 0;
    this.update();
  }

  /** Choose a map where there is none, and have its newest version. */
  update() {
    const maps = this.store.maps();
    if (maps.length && !maps.some(({ id }) => id === this.store.map) && !this.layer.map) {
      this.store.map = maps[0].id;
    }
    this.#list(maps);
    const map = maps.find(({ id }) => id === this.store.map);
    if (!map || this.loading || performance.now() < this.next || this.store.blind) return;
    const wanted = `${map.id} ${map.version}`;
    const alive = map.robots.filter(({ alive }) => alive);
    if (wanted === this.have || !alive.length) return;
    this.#load(alive.find(({ robot }) => robot === this.store.selected) ?? alive[0], map.id, wanted);
  }

  async #load(robot, id, wanted) {
    this.loading = true;
    const begun = performance.now();
    try {
      const map = await unpackMap(await this.link.bytes(`/api/map?robot=${encodeURIComponent(robot.robot)}`));
      if (id !== this.store.map) return;
      const first = !this.layer.map;
      this.layer.set(map);
      this.have = wanted;
      this.notices.end("map");
      if (map.points.length < 2 * map.all_points) {
        this.notices.say("thinned", `Map ${map.name} is large: ${map.points.length / 2} of its ${map.all_points} wall points are drawn.`);
      }
      this.shown(first);
      this.next = performance.now() + Math.max(GROWING_MS, 4 * (performance.now() - begun));
    } catch (error) {
      this.next = performance.now() + AGAIN_MS;
      this.notices.say("map", `No map: ${error.message}`, { alarm: true, lasts: true });
    } finally {
      this.loading = false;
    }
  }

  #list(maps) {
    this.choice.hidden = maps.length === 0;
    const text = maps.map(({ id, name, robots }) => `${id}\t${name} (${robots.length})`).join("\n");
    if (text !== this.listed) {
      this.listed = text;
      this.select.replaceChildren(...maps.map(({ id, name, robots }) => {
        const option = document.createElement("option");
        option.value = id;
        option.textContent = maps.length > 1 ? `${name} (${robots.length})` : name;
        return option;
      }));
    }
    if (this.store.map && this.select.value !== this.store.map) this.select.value = this.store.map;
  }
}
