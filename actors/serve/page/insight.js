// How the walk stands: facts and tables, as often as the server tells.

import { make } from "./panel.js";

function fill(table, rows) {
  table.hidden = !rows.length;
  table.tBodies[0].replaceChildren(...rows.map((cells) =>
    make("tr", {}, ...cells.map((textContent) => make("td", { textContent })))));
}

export function insight(root, state, { latency, rate }) {
  if (!root.open) return;
  const facts = [
    ["view", state.view],
    ["frame, median and 99 %", state.times && `${state.times[0]}, ${state.times[1]} ms`],
    ["frame, aim", `${state.deadline} ms`],
    ["from input to picture", latency ? `${latency[0].toFixed(0)} ms, ${latency[1].toFixed(0)} of them on the way` : null],
    ["received", rate ? `${(rate / 1000).toFixed(1)} Mbit/s` : "nothing new"],
    ["samples traced", state.traced],
    ["samples reused", state.reused],
    ["samples expired", state.expired],
    ["quality", state.quality ?? "not known"],
    ["tiles refined", state.tiles && `${state.tiles[0]} of ${state.tiles[1]}`],
    ["error below", state.error && `${state.error} %`],
    ["environment maps", state.maps && `${state.maps[0]} of ${state.maps[1]} MiB`],
    ["textures", state.textures && `${state.textures[0]} of ${state.textures[1]} MiB`],
    ["walking speed", `${state.speed} a second`],
  ].filter(([, value]) => value != null);
  root.querySelector("#facts").replaceChildren(...facts.flatMap(([name, value]) => [
    make("dt", { textContent: name }),
    make("dd", { textContent: value }),
  ]));
  fill(root.querySelector("#objects"), state.objects.map(([name, , attention, error, level]) => [
    name || "(no name)", attention, error ?? "–", level || "done"]));
  fill(root.querySelector("#actors"), state.actors.map(([name, delivered, waiting, most, busy]) => [
    name, delivered, `${waiting} / ${most}`, busy]));
  fill(root.querySelector("#stations"), state.stations.map(([guest, cores, stands, trip, rate, late, shared, checked]) => [
    guest ?? "–", cores, stands, `${trip} ms`, rate, late, shared, checked]));
}
