"use strict";
for (const button of document.querySelectorAll("button[data-from]")) {
  button.addEventListener("click", () => {
    const time = Bokeh.documents[0].get_model_by_name("time");
    time.setv({start: Number(button.dataset.from), end: Number(button.dataset.to)});
  });
}
for (const key of document.querySelectorAll("button.key")) {
  key.addEventListener("click", () => {
    const shown = key.getAttribute("aria-pressed") !== "true";
    key.setAttribute("aria-pressed", String(shown));
    for (const name of key.dataset.lines.split(" ")) Bokeh.documents[0].get_model_by_name(name).visible = shown;
  });
}
// the values at the cursor stand in the legends of all plots over time
function nearest(times, time) {
  let low = 0, high = times.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < time) low = middle + 1; else high = middle;
  }
  return low > 0 && time - times[low - 1] < times[low] - time ? low - 1 : low;
}
function tell(time) {
  document.getElementById("when").textContent = Number.isFinite(time) ? `at ${time.toFixed(4)} s` : "";
  for (const key of document.querySelectorAll("button.key:has(output)")) {
    const line = Bokeh.documents[0].get_model_by_name(key.dataset.lines.split(" ")[0]);
    const {data} = line.data_source;
    const value = Number.isFinite(time) ? data[line.glyph.y.field][nearest(data.t, time)] : NaN;
    key.querySelector("output").textContent = Number.isFinite(value) ? value.toPrecision(4) : "";
  }
}
// bokeh makes its document when the page is there, and some time after that
function follow() {
  const cursor = Bokeh.documents[0]?.get_model_by_name("cursor");
  if (!cursor) {
    requestAnimationFrame(follow);
    return;
  }
  cursor.properties.location.change.connect(() => tell(cursor.location));
  if (window.matchMedia("(pointer: coarse)").matches) scroll();
}
// a finger scrolls the page, also over a plot; a tool of the plot's bar that is tapped zooms
function scroll() {
  for (const plot of Bokeh.documents[0].roots()) {
    for (const tool of plot.toolbar?.tools ?? []) if (tool.event_types?.includes("pan")) tool.active = false;
  }
}
if (window.Bokeh) follow();
// bokeh asks for the page's colours while it draws, so that it has to draw again when they change
function redraw() {
  if (window.Bokeh) for (const plot of Bokeh.documents[0].roots()) Bokeh.index.get(plot).request_repaint();
}
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
// a browser prints what is folded as folded
let folded = [];
window.addEventListener("beforeprint", () => {
  folded = [...document.querySelectorAll("details:not([open])")];
  for (const each of folded) each.open = true;
});
window.addEventListener("afterprint", () => {
  for (const each of folded) each.open = false;
});
