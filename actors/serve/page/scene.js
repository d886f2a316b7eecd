// What a walk begins anew for: the size of its pictures, its lamps, its files. All that takes a moment.

import { make } from "./panel.js";

const FITS = { page: 1, half: 0.5 };

export class Scene {
  // `deed(message)`: the user wants this, who may have to be told later that it goes on.
  constructor(root, stage, deed) {
    this.root = root;
    this.stage = stage;
    this.deed = deed;
    this.size = root.querySelector("select");
    this.size.addEventListener("change", () => this.fit());
    root.querySelector("button").addEventListener("click", () => deed({ name: "reload" }));
    addEventListener("resize", () => {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.size.value in FITS && this.fit(), 500);
    });
  }

  // The walk is this one now.
  show({ size, lamps, changes }) {
    this.now = size;
    this.changes = changes;
    this.begun ??= this.now;
    const chosen = this.size.value in FITS ? this.size.value : this.now.join();
    const sizes = [this.begun, this.now].map((s) => [s.join(), s.join(" × ")]);
    const all = new Map([...sizes, ["page", "as large as this page has room"], ["half", "half of that: sooner exact"]]);
    this.size.replaceChildren(...[...all].map(([value, textContent]) => make("option", { value, textContent })));
    this.size.value = chosen;
    this.root.querySelector("#lamps").replaceChildren(...lamps.map((lamp, i) => this.lamp(lamp, i)));
  }

  fit() {
    let [width, height] = this.size.value.split(",").map(Number);
    const share = FITS[this.size.value];
    if (share) {
      const isNarrow = matchMedia("(max-width: 56rem)").matches;
      const room = [this.stage.clientWidth, isNarrow ? innerHeight * 0.62 : this.stage.clientHeight];
      [width, height] = room.map((side) => Math.min(4096, Math.max(16, 2 * Math.round(side * share / 2))));
    }
    if (!this.size.disabled && [width, height].join() !== this.now.join()) this.deed({ name: "size", width, height });
  }

  lamp({ name, gain, moves }, lamp) {
    const id = `lamp-${lamp}`;
    const shown = make("output", { htmlFor: id });
    const input = make("input", { type: "range", id, min: 0, max: 4, step: 0.05, value: gain });
    const tell = () => {
      shown.textContent = `${Math.round(input.value * 100)} %`;
      input.setAttribute("aria-valuetext", shown.textContent);
    };
    tell();
    input.addEventListener("input", tell);
    input.addEventListener("change", () => this.deed({ name: "dim", lamp, gain: Number(input.value) }));
    const row = make("div", { className: "row" }, make("label", { htmlFor: id, textContent: name || `lamp ${lamp + 1}` }), shown, input);
    if (!moves) return row;
    const button = make("button", { type: "button", textContent: "Bring it here", ariaLabel: `Bring ${name} to where I stand` });
    button.addEventListener("click", () => this.deed({ name: "bring", lamp }));
    row.append(button);
    return row;
  }

  // A recording is as it was.
  allow(drives, recorded) {
    this.root.hidden = !this.changes || Boolean(recorded);
    for (const input of this.root.querySelectorAll("input, select, button")) input.disabled = !drives;
  }
}
