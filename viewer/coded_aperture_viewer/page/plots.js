"use strict";
// Histogram of depth, or depth along the line that was measured.
const BINS = 60, PLOT = { left: 54, right: 8, top: 8, bottom: 20 };
// Every so many-th pixel is counted.
const COUNTED = 3;

function drawPlot() {
  const isProfile = state.tool === "profile" && state.ends.length === 2;
  $("plot-title").textContent = isProfile ? "Depth along the line" : "Histogram of depth";
  if (!state.frame?.depth) return;
  const plot = newPlot();
  $("plot").setAttribute("aria-label", isProfile ? drawProfile(plot) : drawHistogram(plot));
}
// Canvas in pixels of the display, and the colours of the page.
function newPlot() {
  const canvas = $("plot"), scale = devicePixelRatio || 1, { clientWidth: width, clientHeight: height } = canvas;
  Object.assign(canvas, { width: Math.round(width * scale), height: Math.round(height * scale) });
  const context = canvas.getContext("2d"), style = getComputedStyle(document.body);
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.font = "12px system-ui, sans-serif";
  const [text, line, accent] = ["--text", "--line", "--accent"].map(name => style.getPropertyValue(name));
  return { context, text, line, accent, left: PLOT.left, right: width - PLOT.right, top: PLOT.top, bottom: height - PLOT.bottom };
}
function label({ context, text }, value, x, y, align) {
  context.fillStyle = text;
  context.textAlign = align;
  context.fillText(value, x, y);
}
function axis({ context, line, left, right, bottom }) {
  context.strokeStyle = line;
  context.lineWidth = 1;
  context.beginPath();
  context.moveTo(left, bottom + 0.5);
  context.lineTo(right, bottom + 0.5);
  context.stroke();
}
// How much of the picture has which depth.
function histogram() {
  const { depth, unit_m: unit } = state.frame, { range_m: [near, far], nearer } = state.about;
  const counts = new Uint32Array(BINS), all = new Uint32Array(65536);
  let known = 0, pixels = 0;
  for (let at = 0; at < depth.length; at += COUNTED, pixels++) {
    const step = depth[at];
    if (!step || step >= nearer) continue;
    known++;
    all[step]++;
    counts[Math.max(0, Math.min(BINS - 1, Math.floor((step * unit - near) / (far - near) * BINS)))]++;
  }
  let half = 0, median = 0;
  while (median < 65535 && (half += all[median]) < known / 2) median++;
  return { counts: [...counts].map(count => count / pixels), known: known / pixels, median: known ? median * unit : NaN };
}
function drawHistogram(plot) {
  const { context, left, right, top, bottom } = plot, { counts, known, median } = histogram();
  const { range_m: [near, far] } = state.about, most = Math.max(...counts, 1e-6), wide = (right - left) / BINS;
  counts.forEach((share, bin) => {
    const colour = state.about.colours[Math.round(255 * (1 - (bin + 0.5) / BINS))], high = share / most * (bottom - top);
    context.fillStyle = `rgb(${colour})`;
    context.fillRect(left + bin * wide, bottom - high, Math.ceil(wide), high);
  });
  axis(plot);
  label(plot, `${(100 * most).toFixed(1)} %`, left - 5, top + 8, "right");
  [near, (near + far) / 2, far].forEach((m, at) => label(plot, metres(m), left + (right - left) * at / 2, bottom + 15, ["left", "center", "right"][at]));
  const words = known ? `median ${metres(median)}, ${(100 * known).toFixed(0)} % known` : "no depth is known";
  label(plot, words, right, top + 8, "right");
  return `Histogram of depth: ${words}`;
}
// Depth at about every pixel of the line, with its standard deviation; NaN where it is unknown.
function profile() {
  const [rows, columns] = state.frame.size, [one, other] = state.ends;
  const length = Math.hypot((other[0] - one[0]) * columns, (other[1] - one[1]) * rows), count = Math.max(2, Math.min(400, Math.round(length)));
  return Array.from({ length: count }, (_, at) => {
    const share = at / (count - 1), place = one.map((value, axis) => value + share * (other[axis] - value));
    const z = metresAt(place, state.frame.depth), deviation = metresAt(place, state.frame.deviation);
    return Number.isFinite(z) ? { share, z, deviation: Number.isFinite(deviation) ? deviation : 0 } : { share, z: NaN, deviation: 0 };
  });
}
function drawProfile(plot) {
  const { context, left, right, top, bottom, accent } = plot, line = profile(), known = line.filter(({ z }) => !Number.isNaN(z));
  axis(plot);
  if (!known.length) { label(plot, "no depth is known along the line", left, top + 12, "left"); return "Depth along the line: unknown"; }
  const [low, high] = [Math.min(...known.map(p => p.z - p.deviation)), Math.max(...known.map(p => p.z + p.deviation))];
  const x = share => left + share * (right - left), y = z => top + (z - low) / Math.max(high - low, 1e-6) * (bottom - top);
  context.strokeStyle = context.fillStyle = accent;
  for (const { share, z, deviation } of known) {
    context.globalAlpha = 0.3;
    context.fillRect(x(share) - 0.5, y(z - deviation), Math.max(1, (right - left) / line.length), Math.max(1, y(z + deviation) - y(z - deviation)));
    context.globalAlpha = 1;
    context.fillRect(x(share) - 1, y(z) - 1, 2, 2);
  }
  label(plot, metres(low), left - 5, top + 8, "right");
  label(plot, metres(high), left - 5, bottom, "right");
  label(plot, "first point", left, bottom + 15, "left");
  label(plot, "second", right, bottom + 15, "right");
  return `Depth along the line: ${metres(low)} to ${metres(high)}, near above`;
}
