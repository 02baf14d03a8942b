// Lines at the top of the map. One of a kind; those that last stay until they are ended.

const SHOWN_MS = 12000;
const MOST = 6; // they must not hide the map

export class Notices {
  constructor(place) {
    this.place = place;
    this.lines = new Map();
  }

  /** Say something, for a while (`lasts` false) or until `end(key)`. */
  say(key, text, { alarm = false, lasts = false } = {}) {
    let line = this.lines.get(key);
    if (!line) {
      line = { element: document.createElement("p") };
      const close = document.createElement("button");
      close.textContent = "×";
      close.setAttribute("aria-label", "Dismiss");
      close.onclick = () => this.end(key);
      line.element.append(document.createElement("span"), close);
      this.place.append(line.element);
      this.lines.set(key, line);
      const passing = [...this.lines.keys()].filter((other) => !this.lines.get(other).lasts && other !== key);
      if (this.lines.size > MOST && passing.length) this.end(passing[0]);
    }
    const [span] = line.element.children;
    if (span.textContent !== text) span.textContent = text;
    line.element.classList.toggle("alarm", alarm);
    line.lasts = lasts;
    clearTimeout(line.timer);
    if (!lasts) line.timer = setTimeout(() => this.end(key), SHOWN_MS);
  }

  end(key) {
    clearTimeout(this.lines.get(key)?.timer);
    this.lines.get(key)?.element.remove();
    this.lines.delete(key);
  }
}
