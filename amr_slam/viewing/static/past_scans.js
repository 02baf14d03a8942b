// Scans that this page has been shown, for the time line: in memory that does not grow.

const MOST_NUMBERS = 2e6; // 8 MB: ten minutes of twelve robots at the usual 360 points in 2 s
const MOST = 5000;
const FRESH_S = 6; // three periods of a slow scanner: an older one says nothing of an instant

export class PastScans {
  constructor() {
    this.kept = []; // oldest first
    this.numbers = 0;
  }

  push(name, map, points, time) {
    const flat = new Float32Array(2 * points.length);
    points.forEach((point, i) => flat.set(point, 2 * i));
    this.kept.push({ name, map, time, points: flat });
    this.numbers += flat.length;
    let gone = 0;
    while (this.numbers > MOST_NUMBERS || this.kept.length - gone > MOST) {
      this.numbers -= this.kept[gone].points.length;
      gone += 1;
    }
    if (gone) this.kept.splice(0, gone);
  }

  /** The points [x, y, x, y, ...] of the newest scan of a robot before an instant; null without any. */
  at(name, map, time) {
    for (let i = this.kept.length - 1; i >= 0 && this.kept[i].time > time - FRESH_S; i -= 1) {
      const one = this.kept[i];
      if (one.time <= time && one.name === name) return one.map === map ? one.points : null;
    }
    return null;
  }
}
