"use strict";
// Which panel is large, full screen, and a panel as a file.
const panels = [...document.querySelectorAll(".panel")].map(panel => panel.dataset.panel);
const panelOf = name => document.querySelector(`[data-panel=${name}]`);

function enlarge(name) {
  state.large = name;
  for (const each of panels) panelOf(each).classList.toggle("large", each === name);
  const panel = panelOf(name);
  panel.querySelector(".title").append($("panel-tools"));
  panel.querySelector(".view").append($("overlay"));
  redrawMaps();
  // Points have the colours of the all-in-focus picture.
  if (name === "points" && state.about && state.settings["look.picture"] !== "sharp") choose("sharp");
  if (name === "points") { drawPoints(); if (!state.cloud && state.frame) collectPoints(state.frame, false); }
  drawCursor();
}
function choose(what) {
  $("what").value = what;
  set("look.picture", what);
}
$("what").onchange = () => choose($("what").value);
for (const name of panels) panelOf(name).querySelector(".enlarge").onclick = () => { enlarge(name); $("save").focus(); };

function toggleFullScreen() {
  if (document.fullscreenElement) document.exitFullscreen();
  else $("views").requestFullscreen?.().catch(error => say(String(error), "told"));
}
document.onfullscreenchange = () => { $("full").textContent = document.fullscreenElement ? "Leave full screen" : "Full screen"; };
$("full").onclick = toggleFullScreen;

// The large panel with its colour bar, as a file of the browser's.
function savePanel() {
  if (!state.frame) { say(NO_FRAME, "told"); return; }
  const source = $(state.large), bar = document.querySelector(`#scale-${state.large} canvas`);
  const paper = document.createElement("canvas"), context = paper.getContext("2d"), strip = bar ? 44 : 0;
  Object.assign(paper, { width: source.width, height: source.height + strip });
  context.fillStyle = "#fff";
  context.fillRect(0, 0, paper.width, paper.height);
  context.drawImage(source, 0, 0);
  if (bar) {
    const numbers = [...document.querySelectorAll(`#scale-${state.large} .ends span`)].map(span => span.textContent);
    context.drawImage(bar, 12, source.height + 6, source.width - 24, 12);
    context.fillStyle = "#000";
    context.font = "13px system-ui, sans-serif";
    numbers.forEach((text, at) => {
      context.textAlign = ["left", "center", "right"][at];
      context.fillText(text, 12 + (source.width - 24) * at / 2, source.height + 34);
    });
  }
  const link = document.createElement("a");
  link.download = `${state.large}-${String(state.frame.number).padStart(6, "0")}.png`;
  paper.toBlob(blob => {
    link.href = URL.createObjectURL(blob);
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  });
  say(`saved as ${link.download}`, "told");
}
$("save").onclick = savePanel;
