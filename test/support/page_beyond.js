// What reaches beyond the window to the side, and does not scroll by itself.
(() => {
  const wide = [...document.querySelectorAll("body *")].filter(element => {
    if (!element.checkVisibility() || element.closest("svg") !== null && element.tagName !== "svg") return false;
    for (let at = element.parentElement; at; at = at.parentElement)
      if (["auto", "scroll", "hidden", "clip"].includes(getComputedStyle(at).overflowX)) return false;
    const box = element.getBoundingClientRect();
    return box.right > document.documentElement.clientWidth + 0.5 || box.left < -0.5;
  }).map(element => element.outerHTML.slice(0, 100));
  const { scrollWidth, clientWidth } = document.documentElement;
  return scrollWidth > clientWidth ? [`${scrollWidth} of ${clientWidth} px`, ...wide] : wide;
})()
