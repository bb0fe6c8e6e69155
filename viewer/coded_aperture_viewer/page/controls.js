"use strict";
// Settings by group, presets, and the buttons of the header.
const LABELS = { "depth.confidence_threshold": "Confidence threshold of depth",
  "depth.regularize": "Regularisation", "depth.smoothness": "Smoothness of depth",
  "depth.unknown": "Where depth is unknown", "depth.temporal_frames": "Temporal averaging, frames",
  "depth.check_fit": "Out-of-distribution check", "depth.free_space_risk": "Risk of the free-space bound",
  "depth.second_surface": "Second surface",
  "deblur.smoothness": "Smoothness of the picture",
  "look.opening_px": "Blur out of focus, px" };
const GROUPS = [["Depth", ["depth.confidence_threshold", "depth.unknown", "depth.temporal_frames"]],
  ["Regularisation", ["depth.regularize", "depth.smoothness"]],
  ["Layers and checks", ["depth.free_space_risk", "depth.second_surface", "depth.check_fit"]],
  ["Picture", ["deblur.smoothness", "look.opening_px"]]];

function makeControls() {
  const { controls, layers, read_only: readOnly } = state.about, grouped = new Set(GROUPS.flatMap(([, names]) => names));
  const others = controls.map(({ name }) => name).filter(name => !grouped.has(name));
  const groups = [...GROUPS, ["More", others]].filter(([, names]) => names.length);
  const open = $("settings").querySelector("details[open]")?.dataset.group ?? groups[0][0];
  $("settings").replaceChildren(...groups.map(([title, names]) => group(title, controls.filter(({ name }) => names.includes(name)), open)));
  makePresets();
  const chosen = $("map").value;
  $("map").length = 1;
  for (const layer of layers) {
    const option = new Option(layer.title, layer.name);
    option.title = layer.help;
    $("map").add(option);
  }
  $("map").value = chosen;
  for (const name of ["pause", "snapshot", "record", "form"]) {
    $(name).disabled = readOnly;
    $(name).title = readOnly ? "this viewer is read-only" : "";
  }
}
function group(title, controls, open) {
  const box = document.createElement("details"), summary = document.createElement("summary"), reset = document.createElement("button");
  Object.assign(box, { name: "settings", open: title === open });
  box.dataset.group = title;
  summary.textContent = title;
  Object.assign(reset, { textContent: "Reset", ariaLabel: `Reset: ${title}`, onclick: () => resetSettings(controls.map(({ name }) => name)) });
  box.append(summary, ...controls.map(control), reset);
  return box;
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
  if (!$("what").matches(":focus")) $("what").value = state.settings["look.picture"] ?? "sharp";
}
// Settings that this page may change.
const changeable = name => name.startsWith("look.") || !state.about.read_only;
function resetSettings(names) {
  for (const name of names.filter(changeable)) set(name, state.about.defaults[name]);
  drawSettings();
}
function makePresets() {
  const buttons = state.about.presets.map(preset => Object.assign(document.createElement("button"),
    { textContent: preset.title, title: preset.help, onclick: () => applyPreset(preset) }));
  const reset = Object.assign(document.createElement("button"), { textContent: "Reset all", title: "All settings as at the start",
    onclick: () => resetSettings(Object.keys(state.about.defaults).filter(name => name !== "run.paused")) });
  const note = Object.assign(document.createElement("span"), { id: "shared", className: "quiet" });
  $("presets").replaceChildren(...buttons, reset, note);
}
function applyPreset({ title, help, values, panel, tool }) {
  for (const [name, value] of Object.entries(values).filter(([name]) => changeable(name))) set(name, value);
  setTool(tool);
  enlarge(panel);
  drawSettings();
  say(`${title}: ${help}`, "told");
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
$("pause").onclick = () => { set("run.paused", !state.settings["run.paused"]); drawSettings(); };
$("snapshot").onclick = () => {
  if (!state.frame) say(NO_FRAME, "told");
  else send({ do: "snapshot" });
};
$("record").onclick = () => {
  if (!state.frame) say(NO_FRAME, "told");
  else send({ do: "record", form: $("form").value });
};
