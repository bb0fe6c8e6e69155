"use strict";
// Controls: sliders, boxes and lists of settings, and the figures for setting up.
const LABELS = { "depth.confidence_threshold": "Confidence threshold of depth",
  "depth.regularize": "Regularisation", "depth.smoothness": "Smoothness of depth",
  "depth.unknown": "Where depth is unknown", "depth.temporal_frames": "Temporal averaging, frames",
  "depth.check_fit": "Out-of-distribution check", "depth.free_space_risk": "Risk of the free-space bound",
  "depth.second_surface": "Second surface",
  "deblur.smoothness": "Smoothness of the picture",
  "look.opening_px": "Blur out of focus, px" };

function makeControls() {
  const { controls, layers, read_only: readOnly } = state.about;
  for (const [place, shared] of [["controls", true], ["own", false]]) {
    $(place).replaceChildren(...controls.filter(one => one.shared === shared).map(control));
  }
  const chosen = $("map").value;
  $("map").length = 1;
  for (const layer of layers) {
    const option = new Option(layer.title, layer.name);
    option.title = layer.help;
    $("map").add(option);
  }
  $("map").value = chosen;
  for (const name of ["pause", "snapshot", "record"]) {
    $(name).disabled = readOnly;
    $(name).title = readOnly ? "this viewer is read-only" : "";
  }
}
function control(one) {
  const box = document.createElement("div"), label = document.createElement("label");
  const reason = document.createElement("small");
  box.className = one.kind === "bool" ? "control tick" : "control";
  box.title = one.help;
  label.textContent = LABELS[one.name] ?? one.name;
  label.htmlFor = one.name;
  let input;
  if (one.choices) {
    input = document.createElement("select");
    for (const choice of one.choices) input.add(new Option(choice));
    input.onchange = () => set(one.name, input.value);
  } else {
    input = document.createElement("input");
    if (one.kind === "bool") {
      input.type = "checkbox";
      input.onchange = () => set(one.name, input.checked);
    } else {
      Object.assign(input, { type: "range", min: one.least, max: one.most, step: (one.most - one.least) / 100 });
      const value = document.createElement("output");
      label.append(value);
      input.oninput = () => { value.textContent = digits(one, input.value); set(one.name, Number(input.value)); };
    }
  }
  input.id = one.name;
  box.append(label, input, reason);
  return box;
}
const digits = (one, value) => Number(value).toFixed(one.most < 0.1 ? 4 : 2);
function drawSettings() {
  for (const one of state.about?.controls ?? []) {
    const input = $(one.name), value = state.settings[one.name];
    const reason = one.shared && state.about.read_only ? "" : state.inactive[one.name] ?? "";
    input.disabled = Boolean(reason) || (one.shared && state.about.read_only);
    input.parentElement.classList.toggle("inactive", input.disabled);
    input.parentElement.querySelector("small").textContent = reason;
    if (input.matches(":active")) continue;  // somebody is moving it
    if (input.type === "checkbox") input.checked = value;
    else input.value = value;
    const shown = input.parentElement.querySelector("output");
    if (shown) shown.textContent = digits(one, value);
  }
  $("pause").setAttribute("aria-pressed", state.settings["run.paused"]);
}
// A layer that no setting switches on exists for some cameras only; others cannot be switched on here.
function drawLayerChoice(frame) {
  for (const option of $("map").options) {
    const layer = state.about?.layers.find(({ name }) => name === option.value);
    const given = layer && frame.layers[layer.name];
    option.hidden = Boolean(layer && !layer.setting && !given);
    option.disabled = Boolean(layer?.setting && !given && (state.about.read_only || state.inactive[layer.setting]));
  }
}

// Figures for setting up mask, focus, exposure and the direction of the camera.
let sharpest = 0;
function drawAid(aid) {
  if (!aid || !$("aid").open) { sharpest = 0; return; }
  sharpest = Math.max(sharpest, aid.sharpness);
  const per_cent = share => `${(100 * share).toFixed(1)} %`, { wall } = aid;
  const side = (degrees, positive, negative) =>
    `${Math.abs(degrees).toFixed(1)}° nearer on the ${degrees >= 0 ? positive : negative}`;
  const light = aid.clipped > 0.01 ? "too bright: expose less" : aid.light < 0.05 ? "dark: expose more" : "";
  const rows = [["Light", `${per_cent(aid.light)} of full scale, ${per_cent(aid.clipped)} clipped ${light}`],
    ["Noise", per_cent(aid.noise)], ["Sharpness in the middle", `${aid.sharpness.toFixed(3)}, best ${sharpest.toFixed(3)}`],
    ["Depth known", per_cent(aid.known)],
    ["Wall", wall ? `${wall.distance_m.toFixed(3)} m, ${side(wall.right_nearer_deg, "right", "left")}, ` +
      `${side(wall.lower_nearer_deg, "lower side", "upper side")}, uneven by ${per_cent(wall.uneven)}` : "none found"]];
  $("numbers").replaceChildren(...rows.map(cells => {
    const row = document.createElement("tr");
    for (const text of cells) row.insertCell().textContent = text;
    return row;
  }));
}

function choose(what) {
  $("what").value = what;
  $("of-points").hidden = what !== "points";
  $("of-picture").hidden = what === "points";
  set("look.picture", what === "points" ? "sharp" : what);  // points have its colours
  if (what !== "points") return;
  if (!state.cloud && state.frame) collectPoints(state.frame);  // until a picture comes
  drawPoints();
}
$("what").onchange = () => choose($("what").value);
$("map").onchange = () => {
  send({ layer: $("map").value });
  if (state.frame?.depth) drawMap(state.frame);
};
$("pause").onclick = () => { set("run.paused", !state.settings["run.paused"]); drawSettings(); };
for (const kind of ["snapshot", "record"]) {
  $(kind).onclick = () => {
    if (!state.frame) say(NO_FRAME, "told");
    else send({ do: kind });
  };
}
