// A recording: its frames to go through, its messages, the story of a pixel, and the way out of it.

export class Timeline {
  // `deed(message)`: the user wants this.
  constructor(root, deed) {
    this.root = root;
    this.deed = deed;
    this.at = null;
    this.slider = root.querySelector("input");
    this.slider.addEventListener("input", () => this.go(Number(this.slider.value)));
    const ways = { play: () => deed({ name: "replay" }), branch: () => deed({ name: "branch" }) };
    for (const [key, step] of [["frame-back", -1], ["frame-on", 1]]) ways[key] = () => this.step(step);
    for (const [key, count] of [["back", -1], ["on", 1]]) ways[key] = () => deed({ name: "messages", count });
    for (const button of root.querySelectorAll("button")) button.addEventListener("click", ways[button.dataset.way]);
    this.ways = ways;
  }

  // Scrubbing asks for the newest frame, eight times a second at most.
  go(number) {
    if (this.due === undefined) setTimeout(() => {
      this.deed({ name: "frame", number: this.due });
      this.due = undefined;
    }, 125);
    this.due = Math.min(Math.max(0, number), this.at.frames - 1);
  }

  step(way) { this.go((this.due ?? this.at.frame ?? 0) + way); }

  // Whether a key meant something here.
  key(code) {
    if (!this.at) return false;
    const ways = {
      Space: this.ways.play, ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1),
      Home: () => this.go(0), End: () => this.go(this.at.frames - 1),
      Comma: this.ways.back, Period: this.ways.on, KeyB: this.ways.branch,
    };
    ways[code]?.();
    return code in ways;
  }

  show(at, drives) {
    this.at = at;
    this.root.hidden = !at;
    if (!at) return;
    const frame = at.frame ?? 0;
    this.slider.max = Math.max(1, at.frames - 1);
    if (this.due === undefined) this.slider.value = frame;
    this.slider.setAttribute("aria-valuetext", `frame ${frame} of ${at.frames}`);
    this.root.querySelector("output").textContent = `frame ${frame} of ${at.frames}`;
    this.root.querySelector("[data-way=play]").textContent = at.plays ? "Pause" : "Play";
    for (const input of this.root.querySelectorAll("button, input")) input.disabled = !drives;
    const lines = at.story.length ? at.story : ["Click a pixel for its story.", ...at.lines];
    this.root.querySelector("pre").textContent = [at.position, "", ...lines].join("\n");
  }
}
