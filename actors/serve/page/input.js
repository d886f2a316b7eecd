// Keys, mouse and fingers: what they do to the walk. Times go with them, so the way walked does not depend on the network.

import { now } from "./connection.js";

const [PRESS, RELEASE, LOOK, WHEEL, PACE, RELEASE_ALL, ORBIT] = [1, 2, 3, 4, 5, 6, 7];
const MOTIONS = {
  KeyW: 0, ArrowUp: 0, KeyS: 1, ArrowDown: 1, KeyA: 2, ArrowLeft: 2, KeyD: 3, ArrowRight: 3,
  KeyE: 4, PageUp: 4, KeyQ: 5, PageDown: 5,
};

export const KEYS = [
  ["W A S D, arrows", "walk"],
  ["Q E, Page Down, Page Up", "down, up"],
  ["drag, one finger", "look around"],
  ["two fingers", "walk; pinch for speed"],
  ["wheel", "speed"],
  ["Shift, X", "faster, slower, while held"],
  ["O", "orbit about the middle of the view"],
  ["1 – 9", "go to a place (at first the scene's cameras)"],
  ["Shift + 1 – 9", "remember this place"],
  ["R, P", "record a path, play it (or the scene's)"],
  ["[ ]", "overlay before, after"],
  ["K", "save the picture"],
  ["Space, ← →, comma, period", "in a recording: play, go by frames, by messages"],
  ["click, B", "in a recording: the story of a pixel, walk on"],
  ["F1, ?", "this help"],
];

export class Input {
  // `act`: functions send(events), deed(message), overlay(step), keep(), help(), timeline(code) which says whether a
  // recording took the key, click(x, y) in shares of the picture.
  constructor(canvas, pad, act) {
    this.act = act;
    this.canvas = canvas;
    this.waiting = [];
    this.pointers = new Map();
    this.pace = 0;
    addEventListener("keydown", (e) => this.key(e, true));
    addEventListener("keyup", (e) => this.key(e, false));
    addEventListener("blur", () => this.releaseAll());
    document.addEventListener("visibilitychange", () => document.hidden && this.releaseAll());
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("pointermove", (e) => this.move(e));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => this.up(e));
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.push(WHEEL, -e.deltaY / (e.deltaMode ? 3 : 100));
    }, { passive: false });
    for (const button of pad.querySelectorAll("button")) this.button(button);
  }

  push(kind, a = 0, b = 0) {
    const last = this.waiting.at(-1);
    // Drags between two paintings are one.
    if (kind === LOOK && last?.[1] === LOOK) this.waiting[this.waiting.length - 1] = [now(), LOOK, last[2] + a, last[3] + b];
    else this.waiting.push([now(), kind, a, b]);
    if (!this.soon || this.waiting.length >= 64) this.tick();
  }

  // At once, then with each painting.
  tick() {
    this.soon = this.waiting.length && requestAnimationFrame(() => this.tick());
    this.flush();
  }

  flush() {
    this.act.send(this.waiting);
    this.waiting = [];
  }

  releaseAll() {
    this.push(RELEASE_ALL);
    this.flush();
    this.pace = 0;
    this.walking?.clear();
  }

  // Controls keep their keys; so does the browser.
  isFree(event) {
    const control = event.target.closest?.("input, select, textarea, summary, button, a, dialog");
    return !control && !event.ctrlKey && !event.metaKey && !event.altKey;
  }

  key(event, down) {
    const { code } = event;
    if (down && (code === "F1" || event.key === "?") && !event.target.closest?.("dialog")) {
      event.preventDefault();
      return this.act.help();
    }
    // What went down before a control had the focus must still go up.
    if (down && !this.isFree(event)) return;
    if (down && this.act.timeline(code)) return event.preventDefault();
    if (code.startsWith("Shift") || code === "KeyX") {
      const pace = down ? (code === "KeyX" ? 2 : 1) : 0;
      if (pace !== this.pace) this.push(PACE, this.pace = pace);
      return;
    }
    if (code in MOTIONS) {
      if (down) event.preventDefault();
      if (!event.repeat) this.push(down ? PRESS : RELEASE, MOTIONS[code]);
      return;
    }
    if (!down || event.repeat) return;
    const digit = /^Digit([1-9])$/.exec(code);
    if (digit) this.act.deed({ name: "bookmark", number: digit[1] - 1, set: event.shiftKey });
    else if (code === "KeyO") this.push(ORBIT);
    else if (code === "KeyR") this.act.deed({ name: "record" });
    else if (code === "KeyP") this.act.deed({ name: "play" });
    else if (code === "KeyK") this.act.keep();
    else if (event.key === "[" || event.key === "]") this.act.overlay(event.key === "]" ? 1 : -1);
  }

  down(event) {
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    this.canvas.classList.add("held");
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, way: 0 });
    if (this.pointers.size === 2) this.from = this.pair();
    event.preventDefault();
  }

  move(event) {
    const pointer = this.pointers.get(event.pointerId);
    if (!pointer) return;
    const [dx, dy] = [event.clientX - pointer.x, event.clientY - pointer.y];
    pointer.way += Math.abs(dx) + Math.abs(dy);
    pointer.x = event.clientX;
    pointer.y = event.clientY;
    // A finger holds the picture, a mouse turns the head.
    const way = event.pointerType === "touch" ? -1 : 1;
    if (this.pointers.size === 1) this.push(LOOK, way * dx, way * dy);
    else if (this.pointers.size === 2) this.two();
  }

  up(event) {
    const pointer = this.pointers.get(event.pointerId);
    if (pointer?.way < 5) {
      const { left, top, width, height } = this.canvas.getBoundingClientRect();
      this.act.click((event.clientX - left) / width, (event.clientY - top) / height);
    }
    this.pointers.delete(event.pointerId);
    if (!this.pointers.size) this.canvas.classList.remove("held");
    if (this.from) {
      this.from = null;
      this.walk([]);
    }
  }

  pair() {
    const [a, b] = [...this.pointers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, apart: Math.hypot(a.x - b.x, a.y - b.y) || 1 };
  }

  // Two fingers: away from where they began is a direction, apart is faster.
  two() {
    const at = this.pair();
    const [dx, dy] = [at.x - this.from.x, at.y - this.from.y];
    this.walk([dy < -24 && 0, dy > 24 && 1, dx < -24 && 2, dx > 24 && 3].filter((m) => m !== false));
    const steps = Math.log(at.apart / this.from.apart) / Math.log(1.2);
    if (Math.abs(steps) >= 1) {
      this.push(WHEEL, Math.trunc(steps));
      this.from.apart = at.apart;
    }
  }

  walk(motions) {
    const before = this.walking ?? new Set();
    this.walking = new Set(motions);
    for (const motion of before) if (!this.walking.has(motion)) this.push(RELEASE, motion);
    for (const motion of this.walking) if (!before.has(motion)) this.push(PRESS, motion);
  }

  button(button) {
    const motion = Number(button.dataset.motion);
    let held = false;
    const hold = (now) => {
      if (now === held) return;
      held = now;
      button.classList.toggle("held", held);
      this.push(held ? PRESS : RELEASE, motion);
    };
    button.addEventListener("pointerdown", (e) => { button.setPointerCapture(e.pointerId); hold(true); });
    for (const end of ["pointerup", "pointercancel", "blur"]) button.addEventListener(end, () => hold(false));
    button.addEventListener("keydown", (e) => [" ", "Enter"].includes(e.key) && hold(true));
    button.addEventListener("keyup", () => hold(false));
    button.addEventListener("contextmenu", (e) => e.preventDefault());
  }
}
