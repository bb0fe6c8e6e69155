"use strict";
// Reading under the cursor or finger; a click or tap keeps its place, and focuses there.
const READABLE = ["frame", "depth", "confidence", "picture"];
let cursor = null, kept = null;
function metresAt([x, y], values) {
  const { size: [rows, columns], unit_m } = state.frame, step = values[Math.floor(y * rows) * columns + Math.floor(x * columns)];
  if (!step) return NaN;
  if (step === state.about.beyond) return Infinity;
  return step === state.about.nearer ? -Infinity : step * unit_m;
}
function drawCursor() {
  const place = cursor ?? kept;
  for (const mark of document.querySelectorAll(".view i")) {
    mark.style.display = place ? "block" : "none";
    if (place) Object.assign(mark.style, { left: `${100 * place[0]}%`, top: `${100 * place[1]}%` });
  }
  if (!state.frame) { writeReading("No frame yet", "waiting for the first one"); return; }
  if (!state.frame.depth) { writeReading("No depth", state.frame.problem || "this frame has none"); return; }
  if (!place) {
    const isTouch = matchMedia("(pointer: coarse)").matches;
    writeReading("Depth", isTouch ? "Tap a picture to read its depth and to focus there."
      : "Move over a picture to read its depth; click to focus there.");
    return;
  }
  writeReading(...readingAt(place));
}
function readingAt(place) {
  const { depth: depths, deviation: deviations, size: [rows, columns], confidence, layers } = state.frame;
  const depth = metresAt(place, depths), deviation = metresAt(place, deviations);
  const column = Math.floor(place[0] * columns), row = Math.floor(place[1] * rows);
  const sure = confidence[row * columns + column] / 255;
  const [near, far] = state.about.range_m;
  let text = Number.isNaN(depth) ? "unknown" : depth === Infinity ? `beyond ${far} m` : depth === -Infinity
    ? `nearer than ${near} m` : `${depth.toFixed(depth < 1 ? 3 : 2)} m`;
  if (Number.isFinite(depth) && Number.isFinite(deviation)) text += ` ± ${deviation.toPrecision(2)} m`;
  const others = state.about.layers.map(layer => {
    const values = layers[layer.name];
    if (!values) return "";
    const value = layer.in_metres ? metresAt(place, values) : values[row * columns + column] / 255;
    return Number.isFinite(value) ? `${layer.title}: ${value.toFixed(2)}${layer.in_metres ? " m" : ""}` : "";
  }).filter(Boolean).join(", ");
  return [text, `confidence ${sure.toFixed(2)}, column ${column}, row ${row}`, others];
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
for (const name of READABLE) {
  const canvas = $(name), at = event => {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height]
      .map(share => Math.min(0.9999, Math.max(0, share)));
  };
  canvas.onpointermove = event => { cursor = at(event); drawCursor(); };
  canvas.onpointerleave = () => { cursor = null; drawCursor(); };
  canvas.onclick = event => {
    if (!state.frame) { say(NO_FRAME, "told"); return; }
    kept = at(event);
    drawCursor();
    if (!state.frame.depth) { say(state.frame.problem || "this frame has no depth", "told"); return; }
    const depth = metresAt(kept, state.frame.depth);
    if (!Number.isFinite(depth)) { say("depth is unknown here: click elsewhere to focus", "told"); return; }
    set("look.focus_m", depth);
    choose("refocused");
    say(`focus at ${depth.toFixed(2)} m`, "told");
  };
}
connect();
