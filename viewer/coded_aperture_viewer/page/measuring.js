"use strict";
// Measuring: the distance between two clicks, and the line along which depth is drawn.
const NEEDED = { distance: "Click two points: their distance in space, with its standard deviation.",
                 profile: "Click two points: depth along the line between them." };
Object.assign(state, { tool: "read", ends: [] });

function setTool(tool) {
  Object.assign(state, { tool, ends: [] });
  for (const button of document.querySelectorAll("[data-tool]")) button.setAttribute("aria-pressed", button.dataset.tool === tool);
  drawCursor();
  drawPlot();
  drawPoints();
}
// A third click begins anew.
function addEnd(place) {
  state.ends = state.ends.length === 2 ? [place] : [...state.ends, place];
  cursor = null;
  drawCursor();
  drawPlot();
  if (state.large === "points") drawPoints();
}
// Position of a place of the frame, m, with the standard deviation along its ray; null where depth is unknown.
function pointOf(place) {
  const z = metresAt(place, state.frame.depth), deviation = metresAt(place, state.frame.deviation), [column, row] = pixelAt(place);
  if (!Number.isFinite(z) || !state.frame.rays) return null;
  const [right, down] = rayAt(column, row);
  return { position: [right * z, down * z, z], ray: [right, down, 1], deviation, depth: z };
}
// Distance of the two ends; the errors of their depths count as independent.
function measured() {
  if (state.tool !== "distance" || state.ends.length < 2 || !state.frame?.depth) return null;
  const ends = state.ends.map(pointOf);
  if (ends.includes(null)) return null;
  const between = ends[1].position.map((value, axis) => value - ends[0].position[axis]);
  const distance = Math.hypot(...between);
  const along = end => end.ray.reduce((sum, slope, axis) => sum + slope * between[axis], 0) / (distance || 1) * end.deviation;
  const deviation = Math.hypot(...ends.map(along));
  return { ends, distance, deviation, text: `${distance.toFixed(3)} m ± ${deviation.toPrecision(2)} m` };
}
function measuredText() {
  const { tool, ends } = state;
  if (ends.length < 2) return [ends.length ? "One more point" : tool === "distance" ? "Distance" : "Profile", NEEDED[tool]];
  const found = ends.map(pointOf);
  if (found.includes(null)) return ["unknown", `no depth at the ${found[0] ? "second" : "first"} point: click elsewhere`];
  const depths = ends.map(depthText).join(" to ");
  if (tool === "distance") return [measured().text, `between depths of ${depths}`, "A further click begins anew."];
  return [`${Math.abs(found[1].depth - found[0].depth).toFixed(3)} m in depth`, `from ${depths}`, "A further click begins anew."];
}
// Ends and line on the large picture; the points have their own.
function drawOverlay() {
  const overlay = $("overlay"), [rows, columns] = state.frame?.size ?? [480, 640];
  overlay.setAttribute("viewBox", `0 0 ${columns} ${rows}`);
  const ends = state.large === "points" ? [] : state.ends.map(([x, y]) => [x * columns, y * rows]);
  const make = (name, attributes, text = "") => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    element.textContent = text;
    return element;
  };
  const parts = ends.map(([cx, cy]) => make("circle", { cx, cy, r: columns / 160 }));
  if (ends.length === 2) {
    const [[x1, y1], [x2, y2]] = ends, size = columns / 36, found = measured();
    parts.unshift(make("line", { x1, y1, x2, y2 }));
    const place = { x: Math.min((x1 + x2) / 2 + size / 2, columns * 0.72), y: Math.max(size, (y1 + y2) / 2 - size / 2), "font-size": size };
    if (found) parts.push(make("text", place, found.text));
  }
  overlay.replaceChildren(...parts);
}
for (const button of document.querySelectorAll("[data-tool]")) button.onclick = () => setTool(button.dataset.tool);
