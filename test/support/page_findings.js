// Names of all that is wrong: what has no name, cannot be reached, or is hard to read.
(() => {
  const found = [], say = (what, element) =>
    found.push(`${what}: ${element.outerHTML.replace(/\s+/g, " ").slice(0, 120)}`);
  const isShown = element => element.checkVisibility({ opacityProperty: true, visibilityProperty: true })
    && element.getClientRects().length > 0;
  const modal = document.querySelector("dialog:modal"), all = [...(modal ?? document).querySelectorAll("*")].filter(isShown);
  const nameOf = element => [element.getAttribute("aria-label"), element.title, element.alt,
    ...[...(element.labels ?? [])].map(label => label.textContent),
    ...(element.getAttribute("aria-labelledby") ?? "").split(" ").map(id => document.getElementById(id)?.textContent),
    element.matches("button, a, summary, [role=tab], [role=radio]") ? element.textContent : "",
    ...[...element.querySelectorAll("img")].map(image => image.alt)].join("").trim();
  const interactive = "button, a[href], input, select, textarea, summary, [tabindex], dialog, meter, svg[role=img], canvas";

  if (!document.documentElement.lang) found.push("no language");
  if (!document.title) found.push("no title");
  if (!document.querySelector("main")) found.push("no main");
  if (document.querySelectorAll("h1").length !== 1) found.push("not one h1");
  for (const element of all) {
    if (element.matches(interactive) && !element.closest("[aria-hidden=true]") && !nameOf(element)) say("no name", element);
    if (element.matches("img") && !element.hasAttribute("alt")) say("no alternative text", element);
    if (element.tabIndex > 0) say("order of focus changed", element);
    if (element.id && document.querySelectorAll(`[id="${CSS.escape(element.id)}"]`).length > 1) say("id twice", element);
    const { overflowX, overflowY } = getComputedStyle(element), scrolls = (flow, size, inner) =>
      ["auto", "scroll"].includes(flow) && size > inner + 1;
    if ((scrolls(overflowX, element.scrollWidth, element.clientWidth) || scrolls(overflowY, element.scrollHeight, element.clientHeight))
        && element.tabIndex < 0 && !element.querySelector("button, input, select, [tabindex], summary")) say("scrolls for pointers only", element);
  }
  // ---- contrast of text, WCAG 2.2 AA ----
  const paper = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = colour => {
    paper.clearRect(0, 0, 1, 1);
    paper.fillStyle = colour;
    paper.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = paper.getImageData(0, 0, 1, 1).data;
    return [r, g, b, a / 255];
  };
  const over = ([r, g, b, a], below) => [r, g, b].map((value, at) => a * value + (1 - a) * below[at]);
  const light = rgb => rgb.map(value => value / 255).map(c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4)
    .reduce((sum, c, at) => sum + c * [0.2126, 0.7152, 0.0722][at], 0);
  const behind = element => {
    const layers = [];
    for (let at = element; at; at = at.parentElement) layers.push(rgba(getComputedStyle(at).backgroundColor));
    const canvas = matchMedia("(prefers-color-scheme: dark)").matches ? [18, 18, 18] : [255, 255, 255];
    return layers.reverse().reduce((below, layer) => over(layer, below), canvas);
  };
  for (const element of all) {
    const text = [...element.childNodes].some(node => node.nodeType === 3 && node.data.trim());
    if (!text || element.closest(":disabled, .inactive, svg, [aria-hidden=true]")) continue;
    const style = getComputedStyle(element), back = behind(element), [r, g, b, a] = rgba(style.color);
    const fore = over([r, g, b, a * style.opacity], back), [low, high] = [light(fore), light(back)].sort((x, y) => x - y);
    const size = parseFloat(style.fontSize), isLarge = size >= 24 || (size >= 18.66 && style.fontWeight >= 700);
    const ratio = (high + 0.05) / (low + 0.05);
    if (ratio < (isLarge ? 3 : 4.5)) say(`contrast of ${ratio.toFixed(2)}`, element);
  }
  return found;
})()
