"use strict";
// Turning, moving and zooming the points: pointer, wheel, fingers and keys.
// A press that moves less than this is a click, px.
const CLICK_PX = 4;
const within = (value, most, least = -most) => Math.max(least, Math.min(most, value));
function turn(right, down) {
  state.yaw = (state.yaw + right) % (2 * Math.PI);
  state.pitch = within(state.pitch + down, STEEPEST);
  drawPoints();
}
function move(right, down) {
  state.pan = [within(state.pan[0] + right, 2), within(state.pan[1] + down, 2)];
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
// Index of the point that is shown at a place of the canvas, as shares; -1 if none is near.
function pointAt([right, down]) {
  if (!state.cloud || !state.picked) return -1;
  const [rows, columns] = state.cloud.size, x0 = Math.floor(right * columns), y0 = Math.floor(down * rows);
  for (let reach = 0; reach < 8; reach++) {
    for (let y = Math.max(0, y0 - reach); y <= Math.min(rows - 1, y0 + reach); y++) {
      for (let x = Math.max(0, x0 - reach); x <= Math.min(columns - 1, x0 + reach); x++) {
        if (state.picked[y * columns + x] >= 0) return state.picked[y * columns + x];
      }
    }
  }
  return -1;
}
// Place in the frame of the point at a place of the canvas; null if there is none.
function frameplaceAt(place) {
  const point = pointAt(place);
  if (point < 0) return null;
  const [rows, columns] = state.cloud.size, at = state.cloud.places[point];
  return [(at % columns + 0.5) / columns, (Math.floor(at / columns) + 0.5) / rows];
}
// Turn around the point that is seen there from now on.
function orbitAround(place) {
  const point = pointAt(place);
  if (point < 0 || !state.middle) return;
  state.middle.centre = [...state.cloud.positions.slice(3 * point, 3 * point + 3)];
  state.pan = [0, 0];
  drawPoints();
}
// One pointer turns, or moves with Shift or another button; two move and zoom.
const touching = new Map();
let pressed = null;
const placeOf = event => {
  const box = event.currentTarget.getBoundingClientRect();
  return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
};
$("points").onpointerdown = event => {
  touching.set(event.pointerId, [event.clientX, event.clientY]);
  pressed = touching.size === 1 ? [event.clientX, event.clientY] : null;
  $("points").setPointerCapture(event.pointerId);
};
$("points").onpointermove = event => {
  const before = touching.get(event.pointerId);
  if (!before) return;
  const others = [...touching].filter(([pointer]) => pointer !== event.pointerId).map(([, place]) => place);
  const now = [event.clientX, event.clientY], box = $("points").getBoundingClientRect();
  const [right, down] = [now[0] - before[0], now[1] - before[1]], shorter = Math.min(box.width, box.height);
  touching.set(event.pointerId, now);
  if (pressed && Math.hypot(now[0] - pressed[0], now[1] - pressed[1]) > CLICK_PX) pressed = null;
  if (others.length) {
    zoom(Math.hypot(now[0] - others[0][0], now[1] - others[0][1]) /
         Math.max(1, Math.hypot(before[0] - others[0][0], before[1] - others[0][1])));
    move(right / 2 / shorter, down / 2 / shorter);
  } else if (event.shiftKey || event.buttons > 1) move(right / shorter, down / shorter);
  else turn(3 * right / box.width, 3 * down / box.height);
};
$("points").onpointerup = event => {
  touching.delete(event.pointerId);
  if (!pressed) return;
  const place = frameplaceAt(placeOf(event));
  if (place) clicked(place);
};
$("points").onpointercancel = event => touching.delete(event.pointerId);
$("points").oncontextmenu = event => event.preventDefault();
$("points").onwheel = event => { event.preventDefault(); zoom(Math.exp(-event.deltaY / 600)); };
$("points").ondblclick = event => orbitAround(placeOf(event));
$("points").onkeydown = event => {
  const turnOrMove = (right, down) => event.shiftKey ? move(right, down) : turn(right, down);
  const actions = { ArrowLeft: () => turnOrMove(-0.1, 0), ArrowRight: () => turnOrMove(0.1, 0), ArrowUp: () => turnOrMove(0, -0.1),
    ArrowDown: () => turnOrMove(0, 0.1), "+": () => zoom(1.2), "-": () => zoom(1 / 1.2), 0: resetView };
  if (!actions[event.key] || event.ctrlKey || event.metaKey) return;
  event.preventDefault();
  event.stopPropagation();
  actions[event.key]();
};
$("reset").onclick = resetView;
$("nearer").onclick = () => zoom(1.3);
$("away").onclick = () => zoom(1 / 1.3);
$("colouring").onchange = drawPoints;
