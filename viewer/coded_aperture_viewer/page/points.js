"use strict";
// The points of a frame on their canvas, with axes, the camera's field of view, and what is measured.
// Where no all-in-focus picture comes for so many frames, points have the colours of the coded frame.
const FRAMES_WITHOUT = 60;
// Small, they are drawn this often, ms.
const SMALL_PERIOD_MS = 900;
const BACKGROUND = 0xff181818, AXES = [["x right", "#f66"], ["y down", "#6d6"], ["z away", "#7af"]];
const FRUSTUM_COLOUR = "#ddd", MEASURED_COLOUR = "#fff";

// Depth and colours of one frame; of frames with an all-in-focus picture, if there are such frames.
function collectPoints(frame, isSharp) {
  if (!frame.depth || !frame.rays) return;
  const now = performance.now();
  if (state.large !== "points" && state.cloud && now < state.pointsDue) return;
  state.without = isSharp ? 0 : (state.without ?? 0) + 1;
  if (!isSharp && state.cloud?.isSharp && state.without < FRAMES_WITHOUT) return;
  state.pointsDue = now + SMALL_PERIOD_MS;
  const [rows, columns] = frame.size, source = $(isSharp ? "picture" : "frame");
  if (source.width !== columns || source.height !== rows) return;
  const pixels = canvases[source.id].getImageData(0, 0, columns, rows);
  state.cloud = { ...pointsOf(frame), colours: new Uint32Array(pixels.data.buffer), isSharp, size: frame.size };
  if (!state.middle) findMiddle();
  drawPoints();
}
function pointsOf(frame) {
  const { depth, unit_m: unit, size: [rows, columns] } = frame, { nearer } = state.about;
  const rays = raysOfFrame(frame), places = [], positions = [], depthColours = [], shade = shades(unit);
  for (let row = 0, ray = 0; row < rows; row += 2) for (let column = 0; column < columns; column += 2, ray += 2) {
    const at = row * columns + column, step = depth[at], z = step * unit;
    if (!step || step >= nearer || Number.isNaN(rays[ray])) continue;
    places.push(at);
    positions.push(rays[ray] * z, rays[ray + 1] * z, z);
    depthColours.push(state.colours[shade[step]]);
  }
  return { places, positions: new Float32Array(positions), depthColours };
}
function drawPoints() {
  const size = state.cloud?.size ?? state.frame?.size ?? [480, 640], [rows, columns] = size;
  const context = sized("points", size), image = context.createImageData(columns, rows);
  const words = new Uint32Array(image.data.buffer).fill(BACKGROUND);
  if (!state.cloud || !state.middle) {
    context.putImageData(image, 0, 0);
    write(context, state.frame ? "no depth is known yet" : "no frame has come yet", 12, 24, "#ccc");
    return;
  }
  const view = viewOf(size);
  fillSplats(words, size, view);
  context.putImageData(image, 0, 0);
  drawFrustum(context, view);
  drawAxes(context, view);
  drawMeasured(context, view);
}
// Squares as large as a pixel's part of the surface, the nearest in front; `picked` tells which point a pixel shows.
function fillSplats(words, [rows, columns], { toView, toPixels, focal, nearest }) {
  const { places, positions, colours, depthColours } = state.cloud, byDepth = $("colouring").value === "depth";
  const distance = new Float32Array(words.length).fill(Infinity), picked = state.picked = new Int32Array(words.length).fill(-1);
  const apart = 2 * Math.abs(rayAt(columns / 2 + 1, rows / 2)[0] - rayAt(columns / 2, rows / 2)[0]);
  state.inside = 0;
  for (let at = 0; at < places.length; at++) {
    const z0 = positions[3 * at + 2], seen = toView(positions[3 * at], positions[3 * at + 1], z0), z = seen[2];
    if (z < nearest) continue;
    const [right, down] = toPixels(seen), left = Math.round(right), top = Math.round(down);
    if (left >= 0 && left < columns && top >= 0 && top < rows) state.inside++;
    const wide = Math.min(6, Math.ceil(apart * z0 * focal / z)) + 1, colour = byDepth ? depthColours[at] : colours[places[at]];
    for (let y = Math.max(0, top); y < Math.min(rows, top + wide); y++) {
      for (let x = Math.max(0, left); x < Math.min(columns, left + wide); x++) {
        const to = y * columns + x;
        if (z < distance[to]) { distance[to] = z; words[to] = colour; picked[to] = at; }
      }
    }
  }
}
// A line between two points in space; what is behind the viewer is cut off.
function line(context, { toView, toPixels, nearest }, one, other, colour, width = 2) {
  let [begin, end] = [toView(...one), toView(...other)];
  if (begin[2] > end[2]) [begin, end] = [end, begin];
  if (end[2] <= nearest) return;
  if (begin[2] < nearest) {
    const share = (nearest - begin[2]) / (end[2] - begin[2]);
    begin = begin.map((value, axis) => value + share * (end[axis] - value));
  }
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.beginPath();
  context.moveTo(...toPixels(begin).slice(0, 2));
  context.lineTo(...toPixels(end).slice(0, 2));
  context.stroke();
}
// The camera, and what it sees between the ends of its range.
function drawFrustum(context, view) {
  const [rows, columns] = state.cloud.size, corners = [[0, 0], [columns - 1, 0], [columns - 1, rows - 1], [0, rows - 1]];
  const rays = corners.map(([column, row]) => rayAt(column, row));
  if (rays.flat().some(Number.isNaN)) return;
  const at = (ray, z) => [ray[0] * z, ray[1] * z, z], [near, far] = state.about.range_m;
  rays.forEach((ray, index) => {
    const next = rays[(index + 1) % 4];
    line(context, view, [0, 0, 0], at(ray, far), FRUSTUM_COLOUR, 1);
    for (const z of [near, far]) line(context, view, at(ray, z), at(next, z), FRUSTUM_COLOUR, 1);
  });
}
// Axes of the optical frame at the turning centre, of a round length.
function drawAxes(context, view) {
  const { centre, radius } = state.middle, decade = 10 ** Math.floor(Math.log10(radius / 2));
  const length = decade * [5, 2, 1].find(step => step * decade <= radius / 2);
  AXES.forEach(([name, colour], axis) => {
    const end = centre.map((value, at) => value + (at === axis ? length : 0));
    line(context, view, centre, end, colour);
    const [x, y, z] = view.project(...end);
    if (z > view.nearest) write(context, name, x + 4, y + 4, colour);
  });
  write(context, `axes: ${Number(length.toPrecision(1))} m`, 8, context.canvas.height - 10, "#ddd");
}
function drawMeasured(context, view) {
  const found = measured();
  if (!found) return;
  const [one, other] = found.ends.map(end => end.position);
  line(context, view, one, other, MEASURED_COLOUR, 3);
  const [x, y] = view.project(...one.map((value, axis) => (value + other[axis]) / 2));
  write(context, found.text, x + 6, y - 6, MEASURED_COLOUR);
}
function write(context, text, x, y, colour) {
  context.font = `${Math.max(10, Math.round(context.canvas.width / 45))}px system-ui, sans-serif`;
  context.lineWidth = 3;
  context.strokeStyle = "#000";
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}
