"use strict";
// Keys, the help with their list, and the hint of the first visit.
const HINT_SEEN = "coded-aperture-hint-seen";
const KEYS = [
  ...panels.map((name, index) => [String(index + 1), `large panel: ${$(`title-${name}`).textContent}`, () => enlarge(name)]),
  ["f", "full screen, and back", toggleFullScreen],
  [" ", "pause, and on", () => $("pause").click()],
  ["s", "snapshot: a folder with the frame and its maps", () => $("snapshot").click()],
  ["r", "record, and stop", () => $("record").click()],
  ["p", "save the large panel as a PNG", savePanel],
  ["v", "read", () => setTool("read")],
  ["d", "measure a distance", () => setTool("distance")],
  ["l", "depth along a line", () => setTool("profile")],
  ["0", "points: view as at first", resetView],
  ["Escape", "forget what was measured", () => setTool("read")],
  ["?", "this help", () => $("help").showModal()],
];
const isTyping = element => element.matches("input:not([type=checkbox]), select, textarea");
document.onkeydown = event => {
  const key = KEYS.find(([name]) => name === event.key);
  if (!key || event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog:modal") || isTyping(event.target)) return;
  if (event.key === " " && event.target.matches("button, summary, input")) return;
  event.preventDefault();
  key[2]();
};
fillTable("keys", KEYS.map(([name, does]) => {
  const key = document.createElement("kbd");
  key.textContent = name === " " ? "Space" : name;
  return [key, does];
}));
$("help-open").onclick = () => $("help").showModal();
$("help-close").onclick = () => $("help").close();

// Browsers may refuse to store anything.
function remembered(key) { try { return localStorage.getItem(key); } catch { return null; } }
function remember(key) { try { localStorage.setItem(key, "1"); } catch { /* the hint comes again */ } }
$("hint").hidden = remembered(HINT_SEEN) !== null;
$("hint-close").onclick = () => { $("hint").hidden = true; remember(HINT_SEEN); };

enlarge("depth");
connect();
