"use strict";
// Frames and maps on their canvases, and the colour bars below them.
const GREYS = Uint32Array.from({ length: 256 }, (_, share) => 0xff000000 | share * 0x10101);
// Small panels have every other pixel of larger maps.
const SMALL_FROM = 400;
const metres = m => `${m.toPrecision(3)} m`;
// Standard deviation that is black: a round share of the range.
const worstDeviation = () => { const [near, far] = state.about.range_m; return Number(((far - near) / 5).toPrecision(1)); };

function makeColours() {
  const { colours, range_m: [near, far] } = state.about;
  state.colours = Uint32Array.from(colours, ([r, g, b]) => 0xff000000 | b << 16 | g << 8 | r);
  state.depthScale = [[...state.colours].reverse(), [metres(near), metres((near + far) / 2), metres(far)], true];
  drawScale("depth", ...state.depthScale);
  drawScale("confidence", GREYS, ["0", "0.5", "1"]);
}
// A colour bar with three numbers, and the sign of what is unknown.
function drawScale(name, colours, numbers, hasUnknown = false) {
  const box = $(`scale-${name}`), key = numbers.join();
  if (box.dataset.key === key) return;
  box.dataset.key = key;
  const bar = Object.assign(document.createElement("canvas"), { width: 256, height: 1, ariaHidden: true });
  const context = bar.getContext("2d"), image = context.createImageData(256, 1);
  new Uint32Array(image.data.buffer).set(colours);
  context.putImageData(image, 0, 0);
  const ends = Object.assign(document.createElement("div"), { className: "ends" });
  ends.append(...numbers.map(text => Object.assign(document.createElement("span"), { textContent: text })));
  const unknown = Object.assign(document.createElement("span"), { className: "label" });
  if (hasUnknown) unknown.append(Object.assign(document.createElement("span"), { className: "unknown" }), " unknown");
  box.replaceChildren(bar, unknown, ends);
}
function sized(name, [rows, columns]) {
  const canvas = $(name);
  if (canvas.width !== columns || canvas.height !== rows) Object.assign(canvas, { width: columns, height: rows });
  return canvases[name];
}
function draw(name, bitmap, size) {
  sized(name, size).drawImage(bitmap, 0, 0, size[1], size[0]);
  bitmap.close();
}
// Draw a map; `colourOf` gives the colour of the pixel at an index, row and column.
function paint(name, [rows, columns], colourOf) {
  const step = name !== state.large && columns > SMALL_FROM ? 2 : 1;
  const height = Math.ceil(rows / step), width = Math.ceil(columns / step);
  const context = sized(name, [height, width]), image = context.createImageData(width, height);
  const words = new Uint32Array(image.data.buffer);
  for (let row = 0, to = 0; row < rows; row += step) {
    for (let column = 0, at = row * columns; column < columns; column += step, at += step) words[to++] = colourOf(at, row, column);
  }
  context.putImageData(image, 0, 0);
}
// Colour of every step of depth: nearness from 0 to 255.
function shades(unit) {
  if (state.unit === unit) return state.shades;
  const { range_m: [near, far], nearer, beyond } = state.about, found = new Uint8Array(65536);
  for (let step = 1; step < 65536; step++) {
    const m = step === beyond ? far : step === nearer ? near : step * unit;
    found[step] = 255 * Math.min(1, Math.max(0, (far - m) / (far - near)));
  }
  Object.assign(state, { unit, shades: found });
  return found;
}
// The layer that was chosen, or depth where it is not there.
function drawMap({ depth, layers, size, unit_m }) {
  const chosen = state.about.layers.find(({ name }) => name === $("map").value), values = layers[chosen?.name];
  if (values && !chosen.in_metres) {
    drawScale("depth", GREYS, ["0", "0.50", "1"]);
    drawShare("depth", values, size);
  } else {
    drawScale("depth", ...state.depthScale);
    drawDepth(values ?? depth, size, unit_m);
  }
}
function drawDepth(depth, size, unit_m) {
  const shade = shades(unit_m), colours = state.colours;
  paint("depth", size, (at, row, column) => {
    const step = depth[at];
    if (step) return colours[shade[step]];
    return (row + column >> 1) % 6 === 0 ? 0xffaaaaaa : 0xffe1e1e1;
  });
}
function drawShare(name, share, size) {
  paint(name, size, at => GREYS[share[at]]);
}
// White is what can be trusted: a high confidence, or a small standard deviation.
function drawTrust({ confidence, deviation, size, unit_m }) {
  if ($("trust").value === "confidence") {
    drawScale("confidence", GREYS, ["0", "0.5", "1"]);
    drawShare("confidence", confidence, size);
    return;
  }
  const worst = worstDeviation(), perStep = 255 * unit_m / worst;
  drawScale("confidence", [...GREYS].reverse(), ["0 m", metres(worst / 2), metres(worst)], true);
  paint("confidence", size, (at, row, column) => {
    const step = deviation[at];
    if (step) return GREYS[Math.max(0, Math.round(255 - perStep * step))];
    return (row + column >> 1) % 6 === 0 ? 0xffaaaaaa : 0xffe1e1e1;
  });
}
// Draw the maps of the last frame anew, as after another one was chosen.
function redrawMaps() {
  if (!state.frame?.depth) return;
  drawMap(state.frame);
  drawTrust(state.frame);
}
$("map").onchange = () => {
  send({ layer: $("map").value });
  redrawMaps();
};
$("trust").onchange = redrawMaps;
