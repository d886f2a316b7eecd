// The WebSocket: says hello, reads messages, comes back when it is lost.

const VERSION = 1;
const FINAL = {
  token: "The token in this address is wrong, or missing. Open the address that foveal serve printed.",
  version: "The server is of another version than this page. Load the page again.",
  elsewhere: "This walk goes on in another window.",
  over: "The walk is over.",
  rude: "The server closed the connection: more was sent than it allows.",
  full: "As many look on already as the server lets in.",
};

export const now = () => performance.now();

// The token stands behind the #, so no server sees it; from there it goes into this tab's memory.
function tokenOf() {
  const found = new URLSearchParams(location.hash.slice(1)).get("t");
  if (found) {
    sessionStorage.setItem("foveal.token", found);
    sessionStorage.removeItem("foveal.resume");
    history.replaceState(null, "", location.pathname);
  }
  return found ?? sessionStorage.getItem("foveal.token") ?? "";
}

export class Connection {
  // `on`: functions welcome, frame, file, state, still, values, role, notice, lost(text, willRetry).
  constructor(on) {
    this.on = on;
    this.token = tokenOf();
    this.wait = 0;
    this.set = 0;
    this.socket = null;
    addEventListener("hashchange", () => {
      this.token = tokenOf();
      this.again();
    });
    document.addEventListener("visibilitychange", () => {
      if (!document.hidden && this.sleeps) this.again();
    });
    setInterval(() => { if (!document.hidden) this.say({ type: "here" }); }, 60000);
    this.open();
  }

  again() {
    clearTimeout(this.timer);
    this.wait = 0;
    this.socket?.close();
    this.open();
  }

  open() {
    this.sleeps = false;
    if (!this.token) return this.on.lost(FINAL.token, false);
    const socket = new WebSocket(location.origin.replace("http", "ws") + "/walk");
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    let final = null;
    socket.onopen = () => {
      const resume = sessionStorage.getItem("foveal.resume");
      this.set = 0;
      this.say({ type: "hello", v: VERSION, token: this.token, ...(resume && { resume, camera: this.camera }) });
    };
    socket.onmessage = ({ data }) => {
      if (socket !== this.socket) return;
      if (typeof data !== "string") return this.binary(data);
      const message = JSON.parse(data);
      if (message.type === "bye") final = message.why;
      if (message.type === "welcome") {
        this.wait = 0;
        sessionStorage.setItem("foveal.resume", message.resume);
      }
      // A server that begins anew is told where the walk stood.
      if (message.type === "state") this.camera = message.camera ?? undefined;
      this.on[message.type]?.(message);
    };
    socket.onclose = () => {
      if (socket !== this.socket) return;
      this.socket = null;
      if (FINAL[final]) return this.on.lost(FINAL[final], false);
      if (final === "idle" && document.hidden) {
        this.sleeps = true;
        return this.on.lost("Asleep until somebody looks.", false);
      }
      this.wait = Math.min(8000, this.wait * 2 || 500);
      const why = final === "shutdown" ? "The server has ended" : "The connection is lost";
      this.on.lost(`${why}; trying again …`, true);
      this.timer = setTimeout(() => this.open(), this.wait);
    };
  }

  binary(data) {
    const head = new DataView(data);
    if (head.getUint8(0) === 2) {
      this.say({ type: "kept" });
      return this.on.file(new Uint8Array(data, 1));
    }
    const short = (at) => head.getUint16(at, true);
    const count = short(12);
    this.on.frame({
      lossless: (head.getUint8(1) & 2) > 0,
      number: head.getUint32(4, true),
      width: short(8), height: short(10),
      // Of some tiles only: where they go; they lie in rows of so many in the picture.
      tiles: Array.from({ length: count }, (_, i) => [short(32 + 4 * i), short(34 + 4 * i)]),
      columns: short(14), side: short(16),
      took: short(18) / 10,
      mark: head.getFloat64(24, true),
      bytes: new Uint8Array(data, 32 + 4 * count),
    });
  }

  get isOpen() { return this.socket?.readyState === WebSocket.OPEN; }

  say(message) { if (this.isOpen) this.socket.send(JSON.stringify(message)); }

  // Something after which the picture may be another one. Both sides count, so that none is taken for exact before.
  change(message) {
    if (this.isOpen) this.set++;
    this.say(message);
  }

  // Events: [time, kind, a, b].
  input(events) {
    if (!this.isOpen || !events.length) return;
    const view = new DataView(new ArrayBuffer(17 * events.length));
    events.forEach(([time, kind, a, b], i) => {
      view.setFloat64(17 * i, time, true);
      view.setUint8(17 * i + 8, kind);
      view.setFloat32(17 * i + 9, a, true);
      view.setFloat32(17 * i + 13, b, true);
    });
    this.socket.send(view);
  }
}
