"use strict";

// columns of a point, as `run --stdio` writes them
const TIME = 0, WHEEL = 1, ROAD = 2, SLIP = 3, PHASE = 4, REFERENCE = 5, TORQUE = 6, DRIVE = 7, BRAKE = 8;
const BRAKING = 4;
const PLOTS = [
  { title: "speed [rad/s]", least: 10, lines: [[ROAD, "road", "second"], [WHEEL, "wheel", "first"]] },
  { title: "slip", name: "slip", least: 0.5, most: 1, lines: [[REFERENCE, "reference", "third"], [SLIP, "slip", "first"]] },
  { title: "brake torque asked [N m]", least: 1, lines: [[TORQUE, "torque", "first"]] },
  { title: "duty", least: 1, most: 1, lines: [[DRIVE, "drive", "second"], [BRAKE, "brake", "first"]] },
];
const WINDOW_S = 12, MOST_POINTS = 40000, MORE = 20, AGAIN_MS = 1000;
const EXITS = {
  0: "completed", 3: "completed, with overruns or losses", 5: "safety stop: read the messages", 130: "stopped by the operator",
};

const byId = (id) => document.getElementById(id);
const form = byId("form");
let choices, begun, points, tunable, values, running, view, chosenView, dirty, rows = [], shown = MORE;

// exit codes after which the messages need not be read first
const QUIET = [0, 3, 130];

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

function short(value, digits = 4) {
  return typeof value === "number" ? String(Number(value.toPrecision(digits))) : "–";
}

function say(text) {
  byId("said").textContent = text;
  byId("said").hidden = !text;
}

async function ask(path, body) {
  if (body !== undefined) say("");
  try {
    const request = body === undefined ? {} : { method: "POST", body: JSON.stringify(body) };
    const answer = await fetch(path, request);
    if (!answer.ok) throw new Error(await answer.text());
    return await answer.json();
  } catch (error) {
    say(error.message);
    return undefined;
  }
}

// ---- the live view

function begin(session = "", command = "", controller = "") {
  points = [];
  tunable = new Set();
  values = {};
  running = Boolean(session);
  view = "run";
  chosenView = false;
  for (const id of ["result", "messages", "timing"]) byId(id).replaceChildren();
  byId("command").textContent = command;
  byId("live").hidden = byId("same").hidden = !session;
  byId("state").textContent = session ? "starting" : "ready";
  if (choices && controller) showController(controller);
  begun = controller;
  showRunning();
}

function showRunning() {
  byId("stop").disabled = !running;
  byId("start").disabled = running || !choices;
  enableGains();
  dirty = true;
}

const HANDLERS = {
  begin: (line) => begin(line.begin, line.command, line.controller),
  check: (line) => { byId("state").textContent = line.check; },
  gains: (line) => { tunable = new Set(line.gains.map((gain) => gain.name)); enableGains(); },
  values: (line) => {
    values = line.values;
    showValues();
  },
  changed: (line) => message(`${line.changed.name} = ${short(line.changed.value)} from tick ${line.changed.tick} on`),
  refused: (line) => {
    say(line.refused);
    document.activeElement?.blur(); // what is shown is what is in force
    showValues();
  },
  note: (line) => message(line.note),
  warning: (line) => {
    say(line.warning);
    message(line.warning, true);
  },
  message: (line) => message(line.message, true),
  card: (line) => showCard(line.card),
  state: (line) => {
    for (const point of line.points) {
      if (point[PHASE] > BRAKING) point[SLIP] = null; // of a wheel at rest it says nothing
      points.push(point);
    }
    if (points.length > MOST_POINTS) points.splice(0, points.length - MOST_POINTS);
    if (!chosenView) view = line.points.some((point) => point[PHASE] === BRAKING) ? "braking" : view;
    const state = line.state;
    byId("state").textContent = `${state.phase.toLowerCase().replace("_", " ")}, ${state.time_s.toFixed(1)} s`;
    const [p50, p99, , most] = state.late_us;
    byId("timing").textContent = p50 === null ? "virtual time"
      : `ticks late: median ${short(p50, 3)}, 99 % ${short(p99, 3)}, most ${short(most, 3)} µs; ${state.overruns} periods missed`;
    dirty = true;
  },
  end: (line) => {
    running = false;
    byId("state").textContent = EXITS[line.end] ?? `not completed (exit code ${line.end})`;
    if (!QUIET.includes(line.end)) say([...byId("messages").children].map((item) => item.textContent).join("\n"));
    showRunning();
    loadSessions();
  },
};

function message(text, ill = false) {
  const item = make("li", ill ? { class: "ill" } : {}, text);
  byId("messages").append(item);
}

function showCard(card) {
  const rms = card.slip_rms_true ?? card.slip_rms_estimated;
  const kind = card.slip_rms_true === null ? "estimated" : "true";
  const facts = [card.outcome === "completed" ? "✓ completed" : `✗ ${card.outcome}: ${card.explanation}`];
  if (typeof rms === "number") facts.push(`slip RMS ${short(rms)} (${kind})`);
  if (typeof card.stop_time_s === "number") facts.push(`stopped in ${short(card.stop_time_s)} s`);
  byId("result").replaceChildren(make("span", { class: card.outcome === "completed" ? "well" : "ill" }, facts.join(", ")));
}

function connect() {
  const socket = new WebSocket(`${location.origin.replace("http", "ws")}/live`);
  socket.onopen = () => begin();
  socket.onmessage = (event) => {
    const line = JSON.parse(event.data);
    HANDLERS[Object.keys(line)[0]]?.(line);
  };
  socket.onclose = () => {
    byId("state").textContent = "no connection; trying again (a new server has a new address)";
    setTimeout(connect, AGAIN_MS);
  };
}

for (const plot of PLOTS) {
  const caption = make("figcaption", {}, make("b", {}, plot.title));
  plot.values = plot.lines.map(([, name, colour]) => {
    const value = make("output");
    caption.append(make("span", { class: colour }, `${name} `, value));
    return value;
  });
  plot.canvas = make("canvas", { role: "img", "aria-label": plot.title });
  byId("plots").append(make("figure", { class: plot.name ?? "" }, caption, plot.canvas));
}

function span() {
  const newest = points.length ? points.at(-1)[TIME] : 0;
  if (view === "braking") {
    const last = points.findLastIndex((point) => point[PHASE] === BRAKING);
    if (last >= 0) {
      let first = last;
      while (first > 0 && points[first - 1][PHASE] === BRAKING) first -= 1;
      return [points[first][TIME], Math.max(points[last][TIME], points[first][TIME] + 2)];
    }
  }
  return [Math.max(points.length ? points[0][TIME] : 0, running ? newest - WINDOW_S : 0), Math.max(newest, WINDOW_S / 2)];
}

function niceStep(range, parts) {
  const rough = range / parts, decade = 10 ** Math.floor(Math.log10(rough));
  return decade * [1, 2, 5, 10].find((step) => step * decade >= rough);
}

function drawPlot(plot, shownPoints, [begin, end], colours) {
  const { canvas } = plot, ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight, left = 38, bottom = 18, top = 6;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  let high = plot.least, low = 0;
  for (const point of shownPoints) {
    for (const [column] of plot.lines) {
      high = Math.max(high, point[column] ?? high);
      low = Math.min(low, point[column] ?? low);
    }
  }
  if (plot.most) high = Math.min(high, plot.most);
  const x = (time) => left + ((time - begin) / (end - begin)) * (width - left - 6);
  const y = (value) => top + ((high - value) / (high - low)) * (height - top - bottom);
  context.font = "12px system-ui, sans-serif";
  context.fillStyle = colours.faint;
  context.strokeStyle = colours.line;
  context.lineWidth = 1;
  context.textAlign = "right";
  context.textBaseline = "middle";
  const rise = niceStep(high - low, 4), run = niceStep(end - begin, Math.max(2, width / 110));
  for (let value = Math.ceil(low / rise) * rise; value <= high * 1.0001; value += rise) {
    context.beginPath();
    context.moveTo(left, y(value));
    context.lineTo(width - 6, y(value));
    context.stroke();
    context.fillText(short(value, 3), left - 5, y(value));
  }
  context.textAlign = "center";
  context.textBaseline = "alphabetic";
  for (let time = Math.ceil(begin / run) * run; time <= end * 1.0001; time += run) {
    context.fillText(`${short(time, 4)} s`, Math.min(x(time), width - 16), height - 4);
  }
  context.lineWidth = 1.6;
  for (const [column, name, colour] of plot.lines) {
    context.strokeStyle = colours[colour];
    context.setLineDash(name === "reference" ? [5, 4] : []);
    context.beginPath();
    let drawing = false;
    for (const point of shownPoints) {
      const value = point[column];
      if (value === null) {
        drawing = false;
        continue;
      }
      const at = [x(point[TIME]), y(Math.min(value, high))];
      if (drawing) context.lineTo(...at);
      else context.moveTo(...at);
      drawing = true;
    }
    context.stroke();
  }
  context.setLineDash([]);
  const newest = points.at(-1);
  plot.lines.forEach(([column], at) => { plot.values[at].textContent = newest ? short(newest[column], 3) : ""; });
}

function draw() {
  requestAnimationFrame(draw);
  if (!dirty || byId("live").hidden || document.hidden) return;
  dirty = false;
  const style = getComputedStyle(document.documentElement);
  const colours = Object.fromEntries(
    ["first", "second", "third", "faint", "line"].map((name) => [name, style.getPropertyValue(`--${name}`)]),
  );
  const shownSpan = span();
  const inside = points.filter((point) => point[TIME] >= shownSpan[0] && point[TIME] <= shownSpan[1]);
  for (const plot of PLOTS) drawPlot(plot, inside, shownSpan, colours);
  for (const button of document.querySelectorAll("[data-view]")) {
    button.setAttribute("aria-pressed", String(button.dataset.view === view));
  }
}

for (const button of document.querySelectorAll("[data-view]")) {
  button.onclick = () => {
    view = button.dataset.view;
    chosenView = dirty = true;
  };
}
window.addEventListener("resize", () => { dirty = true; });
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { dirty = true; });
byId("stop").onclick = () => ask("stop", {});

// ---- gains, of the next run or of the one under way

// a slider's middle is the gain's default, its ends are those of the range
function bend(gain) {
  const share = (gain.default - gain.low) / (gain.high - gain.low);
  return share > 0 && share < 1 ? Math.log(share) / Math.log(0.5) : share > 0 ? 1 : 4;
}

function gainRow(gain) {
  const id = `gain-${gain.name}`, power = bend(gain);
  const valueAt = (place) => Number((gain.low + (gain.high - gain.low) * place ** power).toPrecision(3));
  const placeOf = (value) => (Math.max(0, value - gain.low) / (gain.high - gain.low)) ** (1 / power);
  const slider = make("input", { type: "range", id, min: 0, max: 1, step: "any" });
  const typed = make("input", { type: "number", min: gain.low, max: gain.high, step: "any", inputmode: "decimal",
    "aria-label": `${gain.name}, as a number` });
  const row = make("div", { class: "gain", "data-name": gain.name },
    make("label", { for: id }, gain.name, make("small", {}, gain.meaning)), slider, typed,
    make("span", {}, gain.unit === "1" ? "" : gain.unit));
  row.show = (value) => {
    row.value = value;
    typed.value = value;
    slider.value = placeOf(value);
  };
  const choose = async (value) => {
    const before = row.value;
    if (!Number.isFinite(value)) return row.show(before);
    row.show(value);
    if (running && tunable.has(gain.name) && !(await ask("change", { name: gain.name, value }))) row.show(before);
  };
  slider.oninput = () => { typed.value = valueAt(Number(slider.value)); };
  slider.onchange = () => choose(Math.min(Math.max(valueAt(Number(slider.value)), gain.low), gain.high));
  typed.onchange = () => choose(typed.value === "" ? NaN : Number(typed.value));
  row.inputs = [slider, typed];
  row.default = gain.default;
  row.show(gain.default);
  return row;
}

const gainRows = () => [...byId("gains").children];

// another browser may have changed them; what is being typed here stays
function showValues() {
  for (const row of gainRows()) {
    const value = values[row.dataset.name];
    if (value !== undefined && !row.inputs.includes(document.activeElement)) row.show(value);
  }
}

function enableGains() {
  for (const row of gainRows()) {
    for (const input of row.inputs) input.disabled = running && !tunable.has(row.dataset.name);
  }
}

function showGains() {
  byId("gains").replaceChildren(
    ...[choices.start.reference, ...choices.controllers[form.controller.value]].map(gainRow));
  showValues();
  enableGains();
}

function showController(name) {
  if (form.controller.value === name || !choices.controllers[name]) return;
  form.controller.value = name;
  showGains();
}

function options(select, names, texts = names) {
  select.replaceChildren(...names.map((name, at) => make("option", { value: name }, texts[at])));
}

form.onsubmit = async (event) => {
  event.preventDefault();
  const board = form.board.value;
  if (!choices.boards[board] && !confirm(`The wheels of the rig at ${board} will turn. Is the cover closed, and a hand at the emergency switch?`)) return;
  const changed = gainRows().filter((row) => row.value !== row.default).map((row) => [row.dataset.name, row.value]);
  const speed = Number(form.speed.value);
  const started = await ask("run", {
    board,
    virtual: form.time.value === "virtual",
    seed: Number(form.seed.value),
    rig: form.rig.value.trim(),
    controller: form.controller.value,
    estimator: form.estimator.value,
    gains: Object.fromEntries(changed),
    ...(speed === choices.start.speed ? {} : { speed }),
    note: form.note.value,
  });
  if (started) byId("live").scrollIntoView({ behavior: "smooth" });
};

async function loadChoices() {
  choices = await ask("choices");
  if (!choices) return;
  options(form.board, Object.keys(choices.boards));
  options(form.controller, Object.keys(choices.controllers));
  options(form.estimator, ["", ...choices.estimators], ["preferred", ...choices.estimators]);
  form.controller.value = begun || choices.start.controller;
  form.controller.onchange = () => {
    values = {};
    showGains();
  };
  form.estimator.value = choices.start.estimator;
  form.speed.value = choices.start.speed;
  if (!choices.start.real_time) form.time.value = "virtual";
  showGains();
  showRunning();
}

// ---- sessions

async function loadSessions() {
  rows = (await ask("sessions")) ?? rows;
  showSessions();
}

function sessionItem(row) {
  const gains = (row.gains ?? "").split(", ").filter(Boolean).map((name) => `${name} ${short(row[name])}`);
  const rms = row.slip_rms_true ?? row.slip_rms_estimated;
  const facts = [
    [row.controller, row.estimator && `on ${row.estimator}`].filter(Boolean).join(" "),
    typeof row.reference_slip === "number" && `slip ${short(row.reference_slip)}`,
    ...gains,
    row.rig ?? row.board,
    typeof rms === "number" && `slip RMS ${short(rms)}`,
    typeof row.stop_time_s === "number" && `stopped in ${short(row.stop_time_s)} s`,
    row.note, row.problem,
  ];
  const place = `sessions/${encodeURIComponent(row.session)}`;
  const figure = make("button", { type: "button" }, "figure");
  const links = make("div", { class: "links" },
    make("a", { href: `${place}/report.html`, target: "_blank", rel: "noopener" }, "report"), figure,
    make("a", { href: place, download: row.session }, "session"));
  const item = make("li", {},
    make("b", {}, row.session), " ",
    make("span", { class: row.outcome === "completed" ? "well" : "ill" }, row.outcome ?? ""), " ",
    make("small", {}, (row.started_utc ?? "").slice(0, 19).replace("T", " "), row.started_utc ? " UTC" : ""),
    make("div", {}, facts.filter(Boolean).join(", ")), links);
  figure.onclick = () => {
    const image = item.querySelector("img");
    if (image) return image.remove();
    const drawn = make("img", { src: `${place}/figure.svg`, alt: `figure of ${row.session}` });
    drawn.onerror = async () => {
      drawn.remove();
      say(await (await fetch(drawn.src)).text());
    };
    item.append(drawn);
    return undefined;
  };
  return item;
}

function showSessions() {
  const words = byId("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
  const found = rows.filter((row) => {
    const text = Object.values(row).join(" ").toLowerCase();
    return words.every((word) => text.includes(word));
  });
  byId("sessions").replaceChildren(...found.slice(0, shown).map(sessionItem));
  byId("count").textContent = `${found.length} of ${rows.length}`;
  byId("more").hidden = found.length <= shown;
}

byId("filter").oninput = () => {
  shown = MORE;
  showSessions();
};
byId("more").onclick = () => {
  shown += MORE;
  showSessions();
};

begin();
connect();
loadChoices();
loadSessions();
draw();
