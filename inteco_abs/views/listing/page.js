"use strict";
const body = document.querySelector("tbody");
const rows = [...body.rows];
const lineOf = new Map([...document.querySelectorAll(".lines polyline")].map((line) => [line.dataset.row, line]));

function mark(row, here) {
  document.querySelector(`tr[data-row="${row}"]`).classList.toggle("here", here);
  lineOf.get(row)?.classList.toggle("here", here);
}
for (const each of [...rows, ...lineOf.values()]) {
  each.addEventListener("pointerenter", () => mark(each.dataset.row, true));
  each.addEventListener("pointerleave", () => mark(each.dataset.row, false));
}

document.getElementById("filter").addEventListener("input", (event) => {
  const words = event.target.value.toLowerCase().split(/\s+/).filter(Boolean);
  let shown = 0;
  for (const row of rows) {
    const text = row.textContent.toLowerCase();
    const fits = words.every((word) => text.includes(word));
    row.hidden = !fits;
    const line = lineOf.get(row.dataset.row);
    if (line) line.style.display = fits ? "" : "none";
    shown += fits;
  }
  document.getElementById("count").textContent = `${shown} of ${rows.length}`;
});

document.querySelectorAll("th").forEach((head, column) => {
  let falling = true;
  head.addEventListener("click", () => {
    falling = !falling;
    const value = (row) => row.cells[column].dataset.value ?? row.cells[column].textContent;
    const sign = falling ? -1 : 1;
    rows.sort((one, other) => sign * value(one).localeCompare(value(other), "en", { numeric: true }));
    const numeric = rows.every((row) => row.cells[column].dataset.value !== undefined || !value(row));
    if (numeric) rows.sort((one, other) => sign * (parseFloat(value(one) || "Infinity") - parseFloat(value(other) || "Infinity")));
    body.append(...rows);
  });
});
