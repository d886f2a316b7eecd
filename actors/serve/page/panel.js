// The panel: made of the controls that the server knows, which it made of the table that the window uses.

export const make = (tag, properties = {}, ...children) => {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
};
const OPEN = ["Picture", "Overlay"];
const STEPS = 1000;

export class Panel {
  // `set(key, value)`: the user did, which is soon said; `touched()`: it is about to be.
  constructor(form, set, touched) {
    this.form = form;
    this.rows = new Map();
    this.values = {};
    this.due = new Map();
    this.set = set;
    this.touched = touched;
    form.addEventListener("submit", (e) => e.preventDefault());
  }

  // A row for each control, by group.
  build(controls) {
    this.rows.clear();
    const groups = Map.groupBy?.(controls, (c) => c.group) ?? controls.reduce(
      (all, c) => all.set(c.group, [...(all.get(c.group) ?? []), c]), new Map());
    this.form.replaceChildren(...[...groups].map(([name, rows]) => {
      const fields = make("fieldset", {}, make("legend", { textContent: name }), ...rows.map((c) => this.row(c)));
      if (OPEN.includes(name)) return fields;
      fields.firstChild.remove();
      fields.setAttribute("aria-label", name);
      return make("details", {}, make("summary", { textContent: name }), fields);
    }));
  }

  row(control) {
    const id = `c-${control.key}`;
    const help = make("small", { id: `${id}-help`, textContent: control.help });
    const label = make("label", { htmlFor: id, textContent: control.label });
    const row = make("div", { className: `row ${control.kind}` });
    const told = { control, row, at: -Infinity };
    const say = (value) => {
      told.at = performance.now();
      this.send(control.key, value);
    };
    if (control.kind === "switch") {
      told.input = make("input", { type: "checkbox", id });
      told.input.addEventListener("change", () => say(told.input.checked));
      told.put = (on) => { told.input.checked = on; };
      row.append(told.input, label, help);
    } else if (control.kind === "choice" && control.key === "overlay") {
      told.put = (name) => { for (const radio of row.querySelectorAll("input")) radio.checked = radio.value === name; };
      row.className = "choices";
      row.append(...control.names.map((name) => {
        const radio = make("input", { type: "radio", name: control.key, value: name });
        radio.addEventListener("change", () => say(name));
        return make("label", {}, radio, name);
      }));
    } else if (control.kind === "choice") {
      told.input = make("select", { id }, ...control.names.map((name) => make("option", { textContent: name })));
      told.input.addEventListener("change", () => say(told.input.value));
      told.put = (name) => { told.input.value = name; };
      row.append(label, told.input, help);
    } else {
      const [to, from] = scaleOf(control);
      const shown = make("output", { htmlFor: id });
      told.input = make("input", { type: "range", id, min: 0, max: STEPS, step: "any" });
      const tell = (value) => {
        shown.textContent = text(control, value);
        told.input.setAttribute("aria-valuetext", shown.textContent);
      };
      told.input.addEventListener("input", () => {
        const value = from(Number(told.input.value));
        tell(value);
        say(value);
      });
      // Arrow keys go by a hundredth, or by one where it is counted.
      told.input.addEventListener("keydown", (e) => {
        const way = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[e.key];
        if (!way) return;
        e.preventDefault();
        const at = Number(told.input.value);
        let next = Math.min(STEPS, Math.max(0, at + way * STEPS / 100));
        if (control.whole && from(next) === from(at)) next = to(Math.min(control.most, Math.max(control.least, from(at) + way)));
        told.input.value = next;
        told.input.dispatchEvent(new Event("input"));
      });
      told.put = (value) => {
        told.input.value = to(value);
        tell(value);
      };
      row.append(label, shown, told.input, help);
    }
    told.input?.setAttribute("aria-describedby", help.id);
    this.rows.set(control.key, told);
    return row;
  }

  // At most thirty a second, the newest.
  send(key, value) {
    this.values[key] = value;
    this.show();
    if (!this.due.size) setTimeout(() => {
      for (const [key, value] of this.due) this.set(key, value);
      this.due.clear();
    }, 33);
    this.due.set(key, value);
    this.touched();
  }

  // The server's values; what is being dragged stays.
  put(values) {
    for (const [key, value] of Object.entries(values)) {
      const row = this.rows.get(key);
      if (!row || this.due.has(key) || performance.now() - row.at < 400) continue;
      this.values[key] = value;
      row.put(value);
    }
    this.show();
  }

  // What a switch is off for is not there.
  show() {
    for (const { control, row } of this.rows.values()) row.hidden = Boolean(control.needs) && !this.values[control.needs];
  }

  // A recording is as it was, but for how it is looked at.
  allow(drives, recorded) {
    for (const { control, row } of this.rows.values()) {
      const no = !drives || Boolean(recorded) && !control.of_recordings;
      for (const input of row.querySelectorAll("input, select")) input.disabled = no;
    }
  }

  step(key, way) {
    const row = this.rows.get(key);
    if (!row || row.row.querySelector(":disabled")) return;
    const { names } = row.control;
    const next = names[(names.indexOf(this.values[key]) + way + names.length) % names.length];
    row.put(next);
    row.at = performance.now();
    this.send(key, next);
  }
}

// From a value to a place on the slider, and back.
function scaleOf({ least, most, logarithmic, whole }) {
  const [f, g] = logarithmic ? [Math.log, Math.exp] : [(v) => v, (v) => v];
  const span = f(most) - f(least) || 1;
  const to = (value) => (f(value) - f(least)) / span * STEPS;
  const from = (at) => {
    const value = Math.min(most, Math.max(least, g(f(least) + at / STEPS * span)));
    return whole ? Math.round(value) : value;
  };
  return [to, from];
}

function text({ whole, unit, most }, value) {
  const digits = whole ? 0 : Math.abs(value) >= 100 ? 0 : most <= 1 ? 3 : Math.abs(value) >= 10 ? 1 : 2;
  return `${value.toFixed(digits)} ${unit}`.trim();
}
