"use strict";
// Frames and maps on their canvases.
function drawScale() {
  const { colours, range_m: [near, far] } = state.about;
  const words = colours.map(([r, g, b]) => 0xff000000 | b << 16 | g << 8 | r);
  state.colours = new Uint32Array(words.map(word => word >>> 0));
  const scale = $("scale").getContext("2d"), image = scale.createImageData(256, 1);
  new Uint32Array(image.data.buffer).set([...state.colours].reverse());
  scale.putImageData(image, 0, 0);
  const metres = m => `${m.toPrecision(3)} m`;
  $("near").textContent = metres(near);
  $("middle").textContent = metres((near + far) / 2);
  $("far").textContent = metres(far);
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
// Colour of every step of depth: nearness from 0 to 255.
function shades(unit) {
  if (state.unit === unit) return state.shades;
  const { range_m: [near, far], nearer, beyond } = state.about, found = new Uint8Array(65536);
  for (let step = 1; step < 65536; step++) {
    const metres = step === beyond ? far : step === nearer ? near : step * unit;
    found[step] = 255 * Math.min(1, Math.max(0, (far - metres) / (far - near)));
  }
  Object.assign(state, { unit, shades: found });
  return found;
}
// The layer that was chosen, or depth where it is not there.
function drawMap({ depth, layers, size, unit_m }) {
  const chosen = state.about.layers.find(({ name }) => name === $("map").value), values = layers[chosen?.name];
  if (values && !chosen.in_metres) drawShare("depth", values, size);
  else drawDepth(values ?? depth, size, unit_m);
}
function drawDepth(depth, size, unit_m) {
  const context = sized("depth", size), image = context.createImageData(size[1], size[0]);
  const words = new Uint32Array(image.data.buffer), shade = shades(unit_m), colours = state.colours;
  const columns = size[1];
  for (let at = 0; at < depth.length; at++) {
    const step = depth[at];
    if (step) words[at] = colours[shade[step]];
    else words[at] = ((Math.floor(at / columns) + at % columns) >> 1) % 6 === 0 ? 0xffaaaaaa : 0xffe1e1e1;
  }
  context.putImageData(image, 0, 0);
}
function drawShare(name, share, size) {
  const context = sized(name, size), image = context.createImageData(size[1], size[0]);
  const words = new Uint32Array(image.data.buffer);
  for (let at = 0; at < share.length; at++) words[at] = 0xff000000 | share[at] * 0x10101;
  context.putImageData(image, 0, 0);
}
