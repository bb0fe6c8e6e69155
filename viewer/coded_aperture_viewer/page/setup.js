"use strict";
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
  fillTable("numbers", rows);
}
$("aid").ontoggle = () => drawAid(state.frame?.aid);
function fillTable(name, rows) {
  $(name).replaceChildren(...rows.map(cells => {
    const row = document.createElement("tr");
    for (const cell of cells) row.insertCell().append(cell);
    return row;
  }));
}
