"use strict";
// Connection to the viewer, and what arrives over it.
const $ = name => document.getElementById(name);
const contextOf = name => $(name).getContext("2d", { willReadFrequently: true });
const canvases = { frame: contextOf("frame"), depth: contextOf("depth"),
                   confidence: contextOf("confidence"), picture: contextOf("picture"),
                   points: contextOf("points") };
const NO_FRAME = "no frame has come yet: wait for the first one";
// The viewer sends something every few seconds, and a large frame takes a slow network a while.
const SILENCE_MS = 20000;
// Below this value of health a frame is of another camera or bank.
const FITS_FROM = 0.5;
// What was said in answer to a click stays so long.
const SAID_MS = 5000;
// State of the page: settings and the last frame; tests read it as window.viewer.
const state = { about: null, settings: {}, inactive: {}, frame: null, shown: 0 };
window.viewer = state;

let socket, waiting = {}, sending = null, lastSaid = 0, lastHeard = 0, forgetting;
function connect() {
  const address = new URL("live" + location.search, location.href);
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  const opened = socket = new WebSocket(address);
  lastHeard = Date.now();
  socket.binaryType = "arraybuffer";
  socket.onmessage = event => {
    if (opened !== socket) return;
    lastHeard = Date.now();
    if (typeof event.data === "string") told(JSON.parse(event.data));
    else show(event.data).catch(error => say(String(error), "warning"));
  };
  socket.onclose = event => { if (opened === socket) reconnect("connection lost", event.code); };
}
function reconnect(reason, code) {
  socket = null;
  document.body.classList.add("stale");
  if (code !== 1013) say(code === 1001 ? "the viewer has ended" : `${reason}: reconnecting`, "warning");
  setTimeout(connect, code === 1013 ? 5000 : 1000);
}
// A connection that breaks without a word, as out of reach of a network, is not closed by itself.
setInterval(() => {
  if (!socket || Date.now() - lastHeard < SILENCE_MS) return;
  const silent = socket;
  reconnect(`nothing from the viewer for ${SILENCE_MS / 1000} s`);
  silent.close();
}, 1000);

function say(text, kind) {
  $("message").textContent = text;
  $("message").className = text ? kind : "";
  lastSaid = kind === "told" ? Date.now() : 0;
  clearTimeout(forgetting);
  if (kind === "told") forgetting = setTimeout(() => say("", ""), SAID_MS);
}
function send(message) {
  if (socket?.readyState === 1) { socket.send(JSON.stringify(message)); return true; }
  say("not connected to the viewer: nothing was changed", "warning");
  return false;
}
// Sliders move faster than frames come: only the last value is sent.
function set(name, value) {
  state.settings[name] = waiting[name] = value;
  sending ??= setTimeout(() => { send({ set: waiting }); waiting = {}; sending = null; }, 60);
}

function told(message) {
  if (message.controls) begin(message);
  if (message.inactive) state.inactive = message.inactive;
  if (message.pages) drawShared(message);
  if (message.settings && !Object.keys(waiting).length) { state.settings = message.settings; drawSettings(); }
  if (message.said) say(message.said, "told");
  if (message.problem) say(message.problem, state.about ? "told" : "warning");
}
function drawShared({ pages, recorded }) {
  const others = pages > 1 ? `, ${pages} pages are open` : "";
  $("source").title = state.about?.read_only ? `read-only${others}` : `${pages} open`;
  state.recorded = recorded;
  $("record").setAttribute("aria-pressed", recorded !== null);
  $("record").textContent = recorded === null ? "Record" : `Recording: ${recorded}`;
  $("form").disabled = recorded !== null || Boolean(state.about?.read_only);
  $("shared").textContent = state.about?.read_only ? "(read-only)" : pages > 1 ? `(shared by ${pages} pages)` : "";
}
function begin(about) {
  const own = Object.entries(state.settings).filter(([name]) => name.startsWith("look."));
  document.body.classList.remove("stale");
  state.about = about;
  const [near, far] = about.range_m;
  $("source").textContent = about.source;
  $("camera").textContent = $("camera").title = about.camera;
  $("range").textContent = `${Number(near.toPrecision(3))} to ${Number(far.toPrecision(3))} m`;
  makeColours();
  makeControls();
  say(state.frame ? "" : "waiting for the first frame", "note");
  if (!own.length) return;
  // After a break the page keeps what it has shown, and asks for it again.
  about.settings = { ...about.settings, ...Object.fromEntries(own) };
  send({ set: Object.fromEntries(own), layer: $("map").value });
}

async function show(buffer) {
  const length = new DataView(buffer).getUint32(0, true), begin = 8 + length;
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  const part = (name, kind) => {
    if (!head.parts[name]) return null;
    const [at, bytes] = head.parts[name];
    return new kind(buffer, begin + at, bytes / kind.BYTES_PER_ELEMENT);
  };
  const frame = { ...head, depth: part("depth", Uint16Array), deviation: part("std_dev", Uint16Array),
                  confidence: part("confidence", Uint8Array), layers: {} };
  for (const { name, in_metres } of state.about?.layers ?? []) {
    if (head.parts[name]) frame.layers[name] = part(name, in_metres ? Uint16Array : Uint8Array);
  }
  state.frame = frame;
  drawLayerChoice(frame);
  $("rate").textContent = head.rate_hz.toFixed(1);
  $("latency").textContent = head.latency_ms.toFixed(0);
  const unfit = head.health && head.health.value < FITS_FROM ? head.health.said : "";
  $("fit").textContent = head.health ? `${head.health.value.toFixed(2)} ${unfit ? "low" : "good"}` : "not checked";
  $("fit").className = head.health ? (unfit ? "bad" : "good") : "";
  if (Date.now() - lastSaid > SAID_MS) say(head.problem || unfit, "warning");
  if (head.size[0] > 1) await drawFrame(frame, part);
  drawCursor();
  drawPlot();
  drawAid(head.aid);
  state.shown++;
}
async function drawFrame(frame, part) {
  document.documentElement.style.setProperty("--aspect", frame.size[1] / frame.size[0]);
  if (!state.shown) say("", "");
  if (frame.depth) { drawMap(frame); drawTrust(frame); }
  await Promise.all(["frame", "picture"].map(async name => {
    const bytes = part(name, Uint8Array);
    if (bytes) draw(name, await createImageBitmap(new Blob([bytes], { type: "image/jpeg" })), frame.size);
  }));
  collectPoints(frame, Boolean(part("picture", Uint8Array)));
}
