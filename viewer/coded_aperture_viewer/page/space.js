"use strict";
// Geometry: rays of pixels, points in metres in the camera's optical frame, and how a viewer sees them.
// Half of the angle of view, as a tangent along the shorter side.
const HALF_VIEW = 0.4;
const ZOOM = { least: 0.5, most: 8 }, STEEPEST = 1.5;
const FIRST = { yaw: 0.35, pitch: 0.2, closer: 1, pan: [0, 0] };
// Zooms that are tried for the first view; the last one holds all that is within the radius.
const FITS = [2.6, 2.3, 2, 1.8, 1.6, 1.4, 1.2, 1];
Object.assign(state, FIRST, { cloud: null, middle: null });

// Slopes x / z and y / z of a pixel's ray, between those of a grid that come with each frame.
function rayAt(column, row, { rays, size } = state.frame) {
  const { columns, rows, slopes } = rays;
  const u = column / Math.max(1, size[1] - 1) * (columns - 1), v = row / Math.max(1, size[0] - 1) * (rows - 1);
  const left = Math.max(0, Math.min(columns - 2, Math.floor(u))), top = Math.max(0, Math.min(rows - 2, Math.floor(v)));
  const across = u - left, down = v - top;
  return [0, 1].map(axis => {
    const at = (r, c) => slopes[2 * (r * columns + c) + axis] ?? NaN;
    const upper = at(top, left) * (1 - across) + at(top, left + 1) * across;
    const lower = at(top + 1, left) * (1 - across) + at(top + 1, left + 1) * across;
    return upper * (1 - down) + lower * down;
  });
}
// Slopes of every second pixel of every second row; kept until camera or size change.
function raysOfFrame(frame) {
  const key = JSON.stringify([frame.size, frame.rays]);
  if (state.rayKey === key) return state.rayTable;
  const [rows, columns] = frame.size, table = [];
  for (let row = 0; row < rows; row += 2) for (let column = 0; column < columns; column += 2) table.push(...rayAt(column, row, frame));
  Object.assign(state, { rayKey: key, rayTable: Float32Array.from(table) });
  return state.rayTable;
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
  const { cloud: { positions, size, places }, middle } = state, step = Math.ceil(places.length / 200);
  const around = [0, 1, 2, 3, 4, 5, 6, 7].map(eighth => eighth * Math.PI / 4), steep = [-1, -0.5, 0, 0.5, 1];
  return around.every(yaw => steep.every(share => {
    const { project } = viewOf(size, { yaw, pitch: share * STEEPEST, closer: fit / middle.fit, pan: [0, 0] });
    let inside = 0, count = 0;
    for (let at = 0; at < places.length; at += step, count++) {
      const [x, y] = project(positions[3 * at], positions[3 * at + 1], positions[3 * at + 2]);
      inside += x >= 0 && x < size[1] && y >= 0 && y < size[0];
    }
    return inside >= 0.95 * count;
  }));
}
// Functions from the optical frame, m, to right, down and depth as the viewer sees them, and on to pixels of the canvas.
function viewOf([rows, columns], { yaw, pitch, closer, pan } = state) {
  const { centre: [cx, cy, cz], radius, fit } = state.middle;
  const [cosY, sinY, cosP, sinP] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  const shorter = Math.min(rows, columns), focal = shorter / 2 / HALF_VIEW;
  const away = radius * Math.hypot(1, HALF_VIEW) / HALF_VIEW / (closer * fit);
  const [middleX, middleY] = [columns / 2 + pan[0] * shorter, rows / 2 + pan[1] * shorter];
  const toView = (x0, y0, z0) => {
    const x1 = x0 - cx, y1 = y0 - cy, z1 = z0 - cz;
    const x = cosY * x1 + sinY * z1, side = -sinY * x1 + cosY * z1;
    return [x, cosP * y1 - sinP * side, sinP * y1 + cosP * side + away];
  };
  const toPixels = ([x, y, z]) => [middleX + focal * x / z, middleY + focal * y / z, z];
  const project = (x, y, z) => toPixels(toView(x, y, z));
  return { toView, toPixels, project, focal, nearest: 0.05 * radius };
}
