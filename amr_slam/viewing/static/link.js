// The way to the server: its WebSocket, kept open, and questions with the page's token.

const AGAIN_MS = 1000;
const NO_RIGHT = 4401;
const KEY = "amr-slam-token";

export class Link {
  /** `on`: {hello, tick, closed, refused}. */
  constructor(on) {
    this.on = on;
    const given = new URLSearchParams(location.hash.slice(1)).get("token");
    if (given) {
      sessionStorage.setItem(KEY, given);
      window.history.replaceState(null, "", location.pathname); // out of sight, and of bookmarks
    }
  }

  get token() {
    return sessionStorage.getItem(KEY);
  }

  set token(token) {
    if (token) sessionStorage.setItem(KEY, token);
    else sessionStorage.removeItem(KEY);
    this.socket?.close();
  }

  open() {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
    this.socket = socket;
    socket.onopen = () => socket.send(JSON.stringify({ token: this.token }));
    socket.onmessage = ({ data }) => {
      const message = JSON.parse(data);
      this.on[message.type]?.(message);
    };
    socket.onclose = ({ code }) => {
      this.on.closed();
      if (code === NO_RIGHT) this.on.refused();
      setTimeout(() => this.open(), AGAIN_MS);
    };
  }

  send(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** The bytes of an answer. Throws Error with the server's line. */
  async bytes(path) {
    const response = await fetch(path, { headers: this.#headers() });
    if (!response.ok) throw new Error((await response.text()).trim() || response.statusText);
    return response.arrayBuffer();
  }

  /** The robot's reply to a command, or the server's in its place: {ok, error, ...}. */
  async command(robot, command, args) {
    try {
      const response = await fetch("/api/command", {
        method: "POST",
        headers: { ...this.#headers(), "Content-Type": "application/json" },
        body: JSON.stringify({ robot, command, arguments: args }),
      });
      const text = await response.text();
      return text.startsWith("{") ? JSON.parse(text) : { ok: false, error: text.trim() };
    } catch (error) {
      return { ok: false, error: `the view's server does not answer (${error.message})` };
    }
  }

  #headers() {
    return this.token ? { Authorization: `Bearer ${this.token}` } : {};
  }
}
