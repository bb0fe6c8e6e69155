"use strict";
// Points in space, turned around the middle of the points; all stay in the picture.
const TURN = { yaw: 1.3, pitch: 1.0 }, ZOOM = { least: 0.5, most: 6 }, FIRST = { yaw: 0.35, pitch: -0.25, closer: 1 };
// Half of the angle of view, as a tangent along the shorter side.
const HALF_VIEW = 0.4;
// Zooms that are tried for the first view; the last one holds all that is within the radius.
const FITS = [2.6, 2.3, 2, 1.8, 1.6, 1.4, 1.2, 1];
// Where no all-in-focus picture comes for so many frames, points have the colours of the coded frame.
const FRAMES_WITHOUT = 60;
const BACKGROUND = 0xff181818, AXES = [["x right", "#f55"], ["y down", "#5d5"], ["z away", "#6af"]];
Object.assign(state, FIRST, { cloud: null, middle: null });

// Depth and colours of one frame; of frames with an all-in-focus picture, if there are such frames.
function collectPoints(frame, part = () => null) {
  if ($("what").value !== "points" || !frame.depth) return;
  const isSharp = Boolean(part("picture", Uint8Array));
  state.without = isSharp ? 0 : (state.without ?? 0) + 1;
  if (!isSharp && state.cloud?.isSharp && state.without < FRAMES_WITHOUT) return;
  const [rows, columns] = frame.size;
  const pixels = canvases[isSharp ? "picture" : "frame"].getImageData(0, 0, columns, rows);
  state.cloud = { ...pointsOf(frame), colours: new Uint32Array(pixels.data.buffer), isSharp, size: frame.size };
  if (!state.middle) findMiddle();
  drawPoints();
}
function pointsOf({ depth, unit_m: unit, size: [rows, columns] }) {
  const { nearer, focal_px: focal } = state.about, places = [], positions = [];
  for (let row = 0; row < rows; row += 2) for (let column = 0; column < columns; column += 2) {
    const at = row * columns + column, step = depth[at];
    if (!step || step >= nearer) continue;
    const z = step * unit;
    places.push(at);
    positions.push((column - columns / 2) / (focal * columns) * z, (row - rows / 2) / (focal * columns) * z, z);
  }
  return { places, positions: new Float32Array(positions) };
}
// Turning centre, and radius within which nearly all points are.
function findMiddle() {
  const { positions } = state.cloud, count = positions.length / 3;
  if (!count) return;
  const along = axis => Float32Array.from({ length: count }, (_, at) => positions[3 * at + axis]).sort();
  const centre = [0, 1, 2].map(axis => {
    const sorted = along(axis);
    return (sorted[Math.floor(0.02 * count)] + sorted[Math.floor(0.98 * (count - 1))]) / 2;
  });
  const far = Float32Array.from({ length: count }, (_, at) =>
    Math.hypot(...centre.map((value, axis) => positions[3 * at + axis] - value))).sort();
  state.middle = { centre, radius: Math.max(far[Math.floor(0.98 * (count - 1))], 1e-3), fit: 1 };
  state.middle.fit = FITS.find(fitsEverywhere) ?? 1;
}
// Whether nearly all points are in the picture from every direction, with a zoom.
function fitsEverywhere(fit) {
  const { cloud: { positions, size, places }, middle } = state, step = Math.ceil(places.length / 300);
  const directions = [-1, -0.5, 0, 0.5, 1];
  return directions.every(right => directions.every(down => {
    const project = projection(size, { yaw: right * TURN.yaw, pitch: down * TURN.pitch, closer: fit / middle.fit });
    let inside = 0, count = 0;
    for (let at = 0; at < places.length; at += step, count++) {
      const [x, y] = project(...positions.subarray(3 * at, 3 * at + 3));
      inside += x >= 0 && x < size[1] && y >= 0 && y < size[0];
    }
    return inside >= 0.95 * count;
  }));
}
// Right, down and depth of a point in pixels of the canvas, seen from outside.
function projection([rows, columns], { yaw, pitch, closer } = state) {
  const { centre: [cx, cy, cz], radius, fit } = state.middle;
  const [cosY, sinY, cosP, sinP] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  const focal = Math.min(rows, columns) / 2 / HALF_VIEW;
  const away = radius * Math.hypot(1, HALF_VIEW) / HALF_VIEW / (closer * fit);
  return (x0, y0, z0) => {
    const x1 = x0 - cx, y1 = y0 - cy, z1 = z0 - cz;
    const x = cosY * x1 + sinY * z1, side = -sinY * x1 + cosY * z1;
    const y = cosP * y1 - sinP * side, z = sinP * y1 + cosP * side + away;
    return [columns / 2 + focal * x / z, rows / 2 + focal * y / z, z, focal];
  };
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
  const nearest = new Float32Array(words.length).fill(Infinity), project = projection(size);
  const { places, positions, colours } = state.cloud, apart = 2 / (state.about.focal_px * columns);
  state.inside = 0;
  for (let at = 0; at < places.length; at++) {
    const z0 = positions[3 * at + 2], [right, down, z, focal] = project(positions[3 * at], positions[3 * at + 1], z0);
    if (z < 0.05 * state.middle.radius) continue;
    const left = Math.round(right), top = Math.round(down);
    if (left >= 0 && left < columns && top >= 0 && top < rows) state.inside++;
    const wide = Math.min(6, Math.ceil(apart * z0 * focal / z)) + 1, colour = colours[places[at]];
    for (let y = Math.max(0, top); y < Math.min(rows, top + wide); y++) {
      for (let x = Math.max(0, left); x < Math.min(columns, left + wide); x++) {
        const to = y * columns + x;
        if (z < nearest[to]) { nearest[to] = z; words[to] = colour; }
      }
    }
  }
  context.putImageData(image, 0, 0);
  drawAxes(context, project);
}
// Axes of the optical frame at the turning centre, of a round length.
function drawAxes(context, project) {
  const { centre, radius } = state.middle, decade = 10 ** Math.floor(Math.log10(radius / 2));
  const length = decade * [5, 2, 1].find(step => step * decade <= radius / 2);
  const begin = project(...centre);
  AXES.forEach(([name, colour], axis) => {
    const end = project(...centre.map((value, at) => value + (at === axis ? length : 0)));
    context.strokeStyle = colour;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(begin[0], begin[1]);
    context.lineTo(end[0], end[1]);
    context.stroke();
    write(context, name, end[0] + 4, end[1] + 4, colour);
  });
  write(context, `axes: ${Number(length.toPrecision(1))} m`, 8, context.canvas.height - 10, "#ddd");
}
function write(context, text, x, y, colour) {
  context.font = `${Math.max(10, Math.round(context.canvas.width / 45))}px system-ui, sans-serif`;
  context.lineWidth = 3;
  context.strokeStyle = "#000";
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

const within = (value, most, least = -most) => Math.max(least, Math.min(most, value));
function turn(right, down) {
  state.yaw = within(state.yaw + right, TURN.yaw);
  state.pitch = within(state.pitch + down, TURN.pitch);
  drawPoints();
}
function zoom(factor) {
  state.closer = within(state.closer * factor, ZOOM.most, ZOOM.least);
  drawPoints();
}
function resetView() {
  Object.assign(state, FIRST);
  if (state.cloud) findMiddle();
  drawPoints();
}
// One pointer turns, two zoom by their distance.
const touching = new Map();
$("points").onpointerdown = event => {
  touching.set(event.pointerId, [event.clientX, event.clientY]);
  $("points").setPointerCapture(event.pointerId);
};
$("points").onpointermove = event => {
  const before = touching.get(event.pointerId);
  if (!before) return;
  const others = [...touching].filter(([pointer]) => pointer !== event.pointerId).map(([, place]) => place);
  const now = [event.clientX, event.clientY], box = $("points").getBoundingClientRect();
  touching.set(event.pointerId, now);
  if (!others.length) turn(3 * (now[0] - before[0]) / box.width, 3 * (now[1] - before[1]) / box.height);
  else zoom(Math.hypot(now[0] - others[0][0], now[1] - others[0][1]) /
            Math.max(1, Math.hypot(before[0] - others[0][0], before[1] - others[0][1])));
};
$("points").onpointerup = $("points").onpointercancel = event => touching.delete(event.pointerId);
$("points").onwheel = event => { event.preventDefault(); zoom(Math.exp(-event.deltaY / 600)); };
$("points").ondblclick = resetView;
$("points").onkeydown = event => {
  const actions = { ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, -0.1),
    ArrowDown: () => turn(0, 0.1), "+": () => zoom(1.2), "-": () => zoom(1 / 1.2), 0: resetView };
  if (!actions[event.key]) return;
  event.preventDefault();
  actions[event.key]();
};
$("reset").onclick = resetView;
$("nearer").onclick = () => zoom(1.3);
$("away").onclick = () => zoom(1 / 1.3);
