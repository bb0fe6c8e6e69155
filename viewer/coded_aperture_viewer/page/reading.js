"use strict";
// Reading under the cursor or finger; a click or tap keeps its place, and focuses there.
const READABLE = ["frame", "depth", "confidence", "picture"];
let cursor = null, kept = null;
const pixelAt = ([x, y]) => { const [rows, columns] = state.frame.size; return [Math.floor(x * columns), Math.floor(y * rows)]; };
function metresAt(place, values) {
  const [column, row] = pixelAt(place), step = values[row * state.frame.size[1] + column];
  if (!step) return NaN;
  if (step === state.about.beyond) return Infinity;
  return step === state.about.nearer ? -Infinity : step * state.frame.unit_m;
}
function drawCursor() {
  const place = cursor ?? (state.tool === "read" ? kept : null);
  for (const mark of document.querySelectorAll(".view i")) {
    mark.style.display = place ? "block" : "none";
    if (!place) continue;
    Object.assign(mark.style, { left: `${100 * place[0]}%`, top: `${100 * place[1]}%` });
    mark.classList.toggle("left", place[0] > 0.6);
    mark.dataset.text = state.frame?.depth ? depthText(place) : "";
  }
  drawOverlay();
  if (!state.frame) writeReading("No frame yet", "waiting for the first one");
  else if (!state.frame.depth) writeReading("No depth", state.frame.problem || "this frame has none");
  else if (state.tool !== "read" && !cursor) writeReading(...measuredText());
  else if (place) writeReading(...readingAt(place));
  else writeReading("Depth", matchMedia("(pointer: coarse)").matches ? "Tap the large picture to read its depth and to focus there."
    : "Move over the large picture to read its depth; click to focus there.");
}
function depthText(place) {
  const { depth: depths, deviation: deviations } = state.frame, [near, far] = state.about.range_m;
  const depth = metresAt(place, depths), deviation = metresAt(place, deviations);
  if (Number.isNaN(depth)) return "unknown";
  if (!Number.isFinite(depth)) return depth > 0 ? `beyond ${far} m` : `nearer than ${near} m`;
  const text = `${depth.toFixed(depth < 1 ? 3 : 2)} m`;
  return Number.isFinite(deviation) ? `${text} ± ${deviation.toPrecision(2)} m` : text;
}
function readingAt(place) {
  const { confidence, layers, size } = state.frame, [column, row] = pixelAt(place), at = row * size[1] + column;
  const others = state.about.layers.map(layer => {
    const values = layers[layer.name];
    if (!values) return "";
    const value = layer.in_metres ? metresAt(place, values) : values[at] / 255;
    return Number.isFinite(value) ? `${layer.title}: ${value.toFixed(2)}${layer.in_metres ? " m" : ""}` : "";
  }).filter(Boolean).join(", ");
  return [depthText(place), `confidence ${(confidence[at] / 255).toFixed(2)}, column ${column}, row ${row}`, others];
}
function writeReading(first, ...others) {
  const big = document.createElement("b");
  big.textContent = first;
  $("cursor").replaceChildren(big, ...others.filter(Boolean).map(text => {
    const line = document.createElement("small");
    line.textContent = text;
    return line;
  }));
}
// What a click at a place of the frame does, by the tool that is chosen.
function clicked(place) {
  if (!state.frame) { say(NO_FRAME, "told"); return; }
  if (!state.frame.depth) { say(state.frame.problem || "this frame has no depth", "told"); return; }
  if (state.tool !== "read") { addEnd(place); return; }
  kept = place;
  drawCursor();
  if (state.large === "points") return;
  const depth = metresAt(kept, state.frame.depth);
  if (!Number.isFinite(depth)) { say("depth is unknown here: click elsewhere to focus", "told"); return; }
  set("look.focus_m", depth);
  choose("refocused");
  say(`focus at ${depth.toFixed(2)} m`, "told");
}
for (const name of READABLE) {
  const canvas = $(name), at = event => placeOf(event).map(share => Math.min(0.9999, Math.max(0, share)));
  canvas.onpointermove = event => { cursor = at(event); drawCursor(); };
  canvas.onpointerleave = () => { cursor = null; drawCursor(); };
  canvas.onclick = event => clicked(at(event));
}
