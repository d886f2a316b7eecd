// Puts the page together: what the server says goes to its parts, what the user does to the server.

import { Connection } from "./connection.js";
import { Input, KEYS } from "./input.js";
import { insight } from "./insight.js";
import { Panel, make } from "./panel.js";
import { Picture } from "./picture.js";
import { Scene } from "./scene.js";
import { Timeline } from "./timeline.js";

const $ = (id) => document.getElementById(id);
let title = "foveal", scales = null, role = "watches", mayDrive = false, state = null, drawn = null, still = null, said = 0;

// Exact is what was drawn without loss, is what its view converges to, and has all that was set here.
const isExact = () => Boolean(drawn?.lossless && still?.exact) && still.picture === drawn.number
  && still.set === connection.set && !panel.due.size;
const picture = new Picture($("picture"), (frame, could) => {
  connection.say({ type: "shown", frame: frame.number });
  if (!could) tell(`This browser cannot decode ${frame.lossless ? "WebP: it shows no exact pictures" : "JPEG"}.`, true);
  drawn = could ? frame : null;
  $("veil").hidden = true;
  $("keep").disabled = false;
  badge();
});
const fingers = matchMedia("(pointer: coarse)");
fingers.addEventListener("change", () => hints(state?.timeline));
const panel = new Panel($("controls"), (key, value) => {
  connection.change({ type: "set", key, value });
}, () => badge());
const deed = (message) => connection.say({ type: "do", ...message });
const world = new Scene($("scene"), $("stage"), (message) => {
  connection.change({ type: "do", ...message });
  badge();
});
const keep = () => deed({ name: "screenshot" });
const help = () => { if (!$("keys").open) $("keys").showModal(); };
const timeline = new Timeline($("timeline"), deed);
new Input($("picture"), $("pad"), {
  // A recording goes its own way.
  send: (events) => role === "drives" && !timeline.at && connection.input(events),
  deed, keep, help,
  timeline: (code) => timeline.key(code),
  click(x, y) {
    const { width, height } = $("picture");
    const pixel = { x: Math.floor(x * width), y: Math.floor(y * height) };
    if (timeline.at && x >= 0 && y >= 0 && x < 1 && y < 1) deed({ name: "why", ...pixel });
  },
  overlay: (way) => panel.step("overlay", way),
});

function tell(text, failed) {
  // Readers are interrupted at most once a second.
  clearTimeout(tell.timer);
  tell.timer = setTimeout(() => {
    said = performance.now();
    $("notice").dataset.kind = failed ? "bad" : "good";
    $("notice").textContent = text;
    tell.timer = setTimeout(() => { $("notice").textContent = ""; }, failed ? 9000 : 5000);
  }, Math.max(0, said + 1000 - performance.now()));
}

function badge(lost) {
  const exact = !lost && isExact();
  const recorded = state?.timeline && `recorded, frame ${state.timeline.frame ?? 0}`;
  const text = lost ?? recorded ?? (exact ? (state?.state === "refined" ? "exact, refined" : "exact") : state?.state ?? "waiting");
  if ($("state").textContent !== text) $("state").textContent = text;
  $("state").dataset.kind = lost ? "bad" : exact ? "good" : "";
  const overlay = panel.values.overlay && panel.values.overlay !== "none" ? `, overlay ${panel.values.overlay}` : "";
  const label = `${title}, view ${state?.view ?? 0}${overlay}: ${text}`;
  if ($("picture").ariaLabel !== label) $("picture").ariaLabel = label;
}

// What one can do here.
function hints(recorded) {
  const drives = role === "drives";
  panel.allow(drives, recorded);
  world.allow(drives, recorded);
  $("places").hidden = !drives || Boolean(recorded) || !$("places").children.length;
  $("pad").hidden = !drives || Boolean(recorded);
  const how = fingers.matches
    ? "Drag the picture with one finger to look around, walk with the arrows or two fingers."
    : "Drag the picture to look around, walk with W A S D or the arrows.";
  $("hint").textContent = !drives ? "Somebody else walks; you see what they see."
    : recorded ? "A recorded walk: go through its frames, click a pixel for its story, or walk on from any of them."
    : `${how} Stand still and the picture becomes exact.`;
}

function legend() {
  const scale = scales?.overlays[panel.values.overlay];
  $("legend").hidden = !scale;
  if (!scale) return;
  $("legend-name").textContent = panel.values.overlay;
  $("legend-text").textContent = scale.text;
  $("scale").hidden = !scale.ends;
  if (!scale.ends) return;
  [$("least").textContent, $("most").textContent] = scale.ends;
  $("bar").style.background = `linear-gradient(90deg, ${scales.heat.join(", ")})`;
}

const connection = new Connection({
  welcome(message) {
    title = message.title;
    scales = message.ends;
    mayDrive = message.may_drive;
    $("title").textContent = title;
    document.title = `${title} – foveal`;
    panel.build(message.controls);
    world.show(message);
    $("picture").parentElement.style.setProperty("--ratio", message.size[0] / message.size[1]);
    $("veil-text").textContent = "Waiting for the first picture …";
    const place = (textContent, what) => {
      const button = make("button", { type: "button", textContent });
      button.addEventListener("click", () => deed(what));
      return button;
    };
    const places = message.bookmarks.slice(0, 9).map((name, number) => place(name, { name: "bookmark", number, set: false }));
    if (message.paths.length) places.push(place("▶ path", { name: "play" }));
    $("places").replaceChildren(...places);
    this.role({ role: message.role, asked: false, viewers: 1 });
  },
  frame: (frame) => picture.take(frame),
  file(bytes) {
    const href = URL.createObjectURL(new Blob([bytes], { type: "image/png" }));
    const link = make("a", { href, download: `${title.replace(/[^\w-]+/g, "-")}-view-${state?.view ?? 0}.png` });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    tell(`${link.download} saved`);
  },
  state(message) {
    if (!message.timeline !== !state?.timeline) hints(message.timeline);
    state = message;
    timeline.show(state.timeline, role === "drives");
    badge();
    insight($("insight"), state, picture.measured());
  },
  still(message) {
    still = message;
    badge();
  },
  values(message) {
    panel.put(message.values);
    legend();
    badge();
  },
  role(message) {
    if (role === "watches" && message.role === "drives" && message.viewers > 1) tell("You drive now.");
    role = message.role;
    const drives = role === "drives";
    $("take").hidden = drives || !mayDrive;
    $("asked").hidden = !message.asked;
    $("people").hidden = message.viewers < 2 && drives;
    $("people").textContent = (drives ? "you drive" : "you watch") + (message.viewers > 1 ? `, ${message.viewers} look` : "");
    hints(state?.timeline);
    timeline.show(state?.timeline ?? null, drives);
  },
  notice: (message) => tell(message.text, message.failed),
  lost(text, retries) {
    drawn = still = null;
    $("veil").hidden = false;
    $("veil-text").textContent = text;
    $("again").hidden = retries;
    $("keep").disabled = true;
    badge(retries ? "lost, trying" : "not connected");
  },
});

const on = { again: () => connection.again(), take: () => deed({ name: "take" }), give: () => deed({ name: "give" }), keep, help };
for (const [id, act] of Object.entries(on)) $(id).addEventListener("click", act);
$("insight").addEventListener("toggle", () => state && insight($("insight"), state, picture.measured()));
$("keys").querySelector("tbody").append(...KEYS.map(([keys, what]) =>
  make("tr", {}, make("td", {}, make("kbd", { textContent: keys })), make("td", { textContent: what }))));
