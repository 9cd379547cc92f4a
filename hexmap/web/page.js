"use strict";
// The page: its panes, one for each map, under one view; what is asked of the planner; the panel beside them.

const $ = (id) => document.getElementById(id);
const header = JSON.parse($("header").textContent);
// A map in space is cut at one of its heights, metres; one in the plane has none.
const view = { x: 0, y: 0, z: header.heights[header.cut], scale: 1, down: header.yDown };
const inSpace = header.heights.length > 0;
const ends = { start: null, goal: null };
const trajectory = header.trajectory.map((run) => {
  const points = [];
  for (let k = 0, x = 0, y = 0; k < run.length; k += 2) points.push([(x += run[k]) / 1000, (y += run[k + 1]) / 1000]);
  return points;
});
let ticket = 0, pointer = null, frame = 0, playing = 0;

// ---------------------------------------------------------------------- colours

let colours = {};

function readColours() {
  const style = getComputedStyle(document.documentElement), names = {};
  for (const name of ["halo", "path", "start", "goal", "trajectory", "accent", "ink", "plate"]) {
    names[name] = style.getPropertyValue(`--${name}`).trim();
  }
  const numbers = (name) => style.getPropertyValue(`--${name}`).trim().match(/[0-9a-f]{2}/gi).map((v) => parseInt(v, 16) / 255);
  colours = { lines: names, cells: {} };
  for (const name of ["paper", "free", "wall", "edge", "early", "late"]) colours.cells[name] = numbers(name);
}

// ---------------------------------------------------------------------- panes

class Pane {
  constructor(figure, map, name) {
    Object.assign(this, { figure, map, name, path: null, entered: null, answer: null, asked: null, next: null });
    this.canvas = figure.querySelector(".cells");
    this.lines = figure.querySelector(".lines");
    this.caption = figure.querySelector("output");
    this.drawing = new CellDrawing(this.canvas);
    this.overlay = new Overlay(this.lines);
    this.loaded = new Map();
    // Phones take the graphics card away from pages in the background.
    this.canvas.addEventListener("webglcontextlost", (event) => (event.preventDefault(), this.drawing.forget()));
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.drawing.setLevel(this.lattice, this.cells);
      this.drawing.setEntered(this.answer?.entered ?? null);
      invalidate();
    });
  }

  // Unpack a level, once, and show it.
  async show(k) {
    const numbers = this.map.levels[k];
    if (!this.loaded.has(k)) this.loaded.set(k, new Cells(numbers, await unpack($(`cells-${this.name}-${k}`).textContent), this.map.rule));
    this.numbers = numbers;
    this.lattice = inSpace ? new SpatialLattice(numbers) : new Lattice(numbers);
    this.cells = this.loaded.get(k);
    if (this.drawing.works) this.drawing.setLevel(this.lattice, this.cells);
    if (!inSpace) worker.postMessage({ kind: "level", name: this.name, numbers, tiles: this.cells.states, settings: settings() });
  }

  // Pixels of the screen from metres, and back; (0, 0) is the pane's upper left corner.
  toPixels(x, y) {
    const { clientWidth: w, clientHeight: h } = this.lines;
    return [w / 2 + (x - view.x) * view.scale, h / 2 + (view.down ? 1 : -1) * (y - view.y) * view.scale];
  }

  toMetres(u, v) {
    const { clientWidth: w, clientHeight: h } = this.lines;
    return [view.x + (u - w / 2) / view.scale, view.y + ((view.down ? 1 : -1) * (v - h / 2)) / view.scale];
  }

  resize() {
    const ratio = devicePixelRatio || 1, { clientWidth: w, clientHeight: h } = this.lines;
    for (const canvas of [this.canvas, this.lines]) {
      const width = Math.max(1, Math.round(w * ratio)), height = Math.max(1, Math.round(h * ratio));
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    }
  }

  draw() {
    const ratio = devicePixelRatio || 1;
    if (!this.cells) return;
    // Lattices of one resolution are shown in the same detail, lest one looks coarser than the other.
    const detail = Math.max(...panes.map((pane) => (pane.drawing.cells ? pane.drawing.detailFor(view, ratio) : 0)));
    if (this.drawing.works) this.drawing.draw(view, ratio, detail, colours.cells, Number($("time").value) / 1000);
    // Where the pointer is on the screen stays when the view moves.
    const point = pointer?.pane.toMetres(...pointer.at) ?? (this.lines.matches(":focus-visible") ? [view.x, view.y] : null);
    const hovered = point && this.lattice.quantise(...point, view.z);
    this.overlay.draw(view, ratio, (x, y) => this.toPixels(x, y), colours.lines, {
      trajectory, hovered: inSpace ? null : hovered, lattice: this.lattice, path: this.path, ...this.shownEnds(),
      cross: pointer === null && this.lines.matches(":focus-visible"),
    });
    this.describe(point, hovered);
  }

  // The ends of a path are centres of cells.
  shownEnds() {
    const centre = (point) => point && this.lattice.centre(...this.lattice.quantise(...point));
    return { start: centre(ends.start), goal: centre(ends.goal) };
  }

  describe(point, cell) {
    if (!point) return void (this.caption.textContent = "");
    const { state, hits, passes } = this.cells.at(...cell), number = (v) => v.toLocaleString("en");
    const counts = hits === undefined ? "" : `, ${number(hits)} hits, ${number(passes)} passes`;
    const metres = [...point, ...(inSpace ? [view.z] : [])].map((v) => v.toFixed(digitsFor(this.lattice))).join(", ");
    this.caption.textContent = `${metres} m · cell (${cell.join(", ")}) ${["unknown", "free", "occupied"][state]}${counts}`;
  }

  // Ask for a path; what is asked while an answer is awaited replaces what waits.
  ask(question) {
    if (this.asked !== null) return void (this.next = question);
    this.asked = question.ticket;
    const cell = (point) => this.lattice.quantise(...point);
    worker.postMessage({ ...question, kind: "plan", name: this.name, start: cell(ends.start), goal: cell(ends.goal) });
  }

  receive(answer) {
    this.asked = null;
    if (this.next) {
      const question = this.next;
      this.next = null;
      this.ask(question);
    }
    if (answer.ticket < this.cleared) return;
    this.answer = answer;
    this.path = answer.cells ? answer.cells.map(([a, b]) => this.lattice.centre(a, b)) : null;
    if (this.drawing.works) this.drawing.setEntered(answer.entered ?? null);
  }

  clear() {
    Object.assign(this, { path: null, answer: null, next: null, cleared: ticket + 1 });
    if (this.drawing.works && this.cells) this.drawing.setEntered(null);
  }
}

// Digits behind the point, so that a tenth of a cell shows.
const digitsFor = (lattice) => Math.max(2, Math.ceil(1 - Math.log10(lattice.resolution)));

function invalidate() {
  frame ||= requestAnimationFrame(() => {
    frame = 0;
    panes.forEach((pane) => pane.draw());
  });
}

// ---------------------------------------------------------------------- the view

function fit() {
  const [left, low, right, high] = header.bounds, { clientWidth: w, clientHeight: h } = panes[0].lines;
  view.x = (left + right) / 2;
  view.y = (low + high) / 2;
  view.scale = 0.94 * Math.min(w / Math.max(right - left, 1e-6), h / Math.max(high - low, 1e-6));
  invalidate();
}

function pan(u, v) {
  view.x -= u / view.scale;
  view.y -= ((view.down ? 1 : -1) * v) / view.scale;
  invalidate();
}

// Zoom by a factor about a point of a pane, in pixels.
function zoom(factor, pane, u = pane.lines.clientWidth / 2, v = pane.lines.clientHeight / 2) {
  const [x, y] = pane.toMetres(u, v), finest = panes[0].map.levels[0].resolution;
  view.scale = Math.min(400 / finest, Math.max(view.scale * factor, 1e-3));
  const [nx, ny] = pane.toMetres(u, v);
  view.x += x - nx;
  view.y += y - ny;
  invalidate();
}

// ---------------------------------------------------------------------- paths

function settings() {
  return {
    neighbourhood: $("neighbourhood").value,
    radius: Math.max(0, Number($("radius").value) || 0),
    weight: $("any-angle").checked ? 0 : Number($("weight").value) || 0,
    anyAngle: $("any-angle").checked,
  };
}

function plan() {
  ticket++;
  $("weight").disabled = $("any-angle").checked;
  $("weight-shown").textContent = $("weight").value;
  for (const role of ["start", "goal"]) {
    if (document.activeElement !== $(`${role}-x`) && document.activeElement !== $(`${role}-y`)) {
      $(`${role}-x`).value = ends[role] ? ends[role][0].toFixed(2) : "";
      $(`${role}-y`).value = ends[role] ? ends[role][1].toFixed(2) : "";
    }
  }
  if (ends.start && ends.goal) panes.forEach((pane) => pane.ask({ ticket, ...settings() }));
  else report();
  invalidate();
}

// Put an end somewhere: without a role the start if it is missing, else the goal.
function place(point, role = ends.start ? "goal" : "start") {
  if (inSpace) return;
  ends[role] = point;
  plan();
}

function clearPath() {
  ends.start = ends.goal = null;
  stopPlaying();
  panes.forEach((pane) => pane.clear());
  plan();
}

function report() {
  const metres = (v) => (v === Infinity ? "no wall" : `${v.toFixed(2)} m`);
  const rows = {
    length: (r) => metres(r.length), turning: (r) => `${Math.round((180 * r.turning) / Math.PI)}°`,
    clearance: (r) => metres(r.clearance),
  };
  panes.forEach((pane, k) => {
    const r = pane.answer;
    for (const [name, text] of Object.entries(rows)) $(`${name}-${k}`).textContent = r?.cells ? text(r) : "–";
    $(`expansions-${k}`).textContent = r?.ms === undefined ? "–" : r.expansions.toLocaleString("en");
    $(`ms-${k}`).textContent = r?.ms === undefined ? "–" : `${r.ms.toFixed(1)} ms`;
  });
  const reasons = panes.flatMap((p) => (p.answer?.reason ? [panes.length > 1 ? `${p.map.title}: ${p.answer.reason}` : p.answer.reason] : []));
  const blind = panes.some((pane) => !pane.drawing.works);
  const missing = blind ? "Without WebGL 2 there is only a picture; give start and goal in numbers." : !ends.start ? "Click or tap to set the start." : !ends.goal ? "Now the goal." : "";
  $("status").textContent = missing || reasons.join(" ") || "Drag A or B to move an end of the path.";
  $("play").disabled = $("time").disabled = !panes.some((pane) => pane.answer?.entered);
  invalidate();
}

function stopPlaying() {
  cancelAnimationFrame(playing);
  playing = 0;
  $("play").textContent = "Play the search";
}

// Show the cells in the order in which the search entered them, within three seconds.
function play() {
  if (playing) return stopPlaying();
  const begin = performance.now(), from = Number($("time").value) >= 1000 ? 0 : Number($("time").value);
  $("play").textContent = "Stop";
  const step = (now) => {
    const value = Math.min(1000, from + (now - begin) / 3);
    $("time").value = value;
    panes.forEach((pane) => pane.draw());
    if (value < 1000) playing = requestAnimationFrame(step);
    else stopPlaying();
  };
  playing = requestAnimationFrame(step);
}

// ---------------------------------------------------------------------- pointers and keys

function listen(pane) {
  const down = new Map();
  let moved = 0, dragged = null, spread = 0;
  const { lines } = pane;
  const place_ = (event) => {
    const box = lines.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const near = (u, v, reach) => {
    const shown = pane.shownEnds();
    return ["goal", "start"].find((role) => shown[role] && Math.hypot(...pane.toPixels(...shown[role]).map((p, k) => p - [u, v][k])) < reach);
  };
  lines.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    lines.setPointerCapture(event.pointerId);
    const [u, v] = place_(event);
    down.set(event.pointerId, [u, v]);
    moved = down.size > 1 ? Infinity : 0;
    dragged = down.size === 1 ? near(u, v, event.pointerType === "touch" ? 26 : 14) : null;
    spread = 0;
  });
  lines.addEventListener("pointermove", (event) => {
    const [u, v] = place_(event), before = down.get(event.pointerId);
    pointer = { pane, at: [u, v] };
    if (!before) {
      lines.style.cursor = near(u, v, 14) ? "grab" : "crosshair";
      return invalidate();
    }
    down.set(event.pointerId, [u, v]);
    moved += Math.hypot(u - before[0], v - before[1]);
    if (dragged && moved > 3) place(pane.toMetres(u, v), dragged);
    else if (down.size === 1 && moved > 4) pan(u - before[0], v - before[1]);
    else if (down.size === 2) {
      const [[a, b], [c, d]] = [...down.values()], wide = Math.hypot(a - c, b - d);
      pan((u - before[0]) / 2, (v - before[1]) / 2);
      if (spread) zoom(wide / spread, pane, (a + c) / 2, (b + d) / 2);
      spread = wide;
    }
  });
  const up = (event) => {
    const [u, v] = place_(event);
    if (down.delete(event.pointerId) && event.type === "pointerup" && moved <= 4 && !dragged) {
      place(pane.toMetres(u, v), event.shiftKey ? "start" : undefined);
    }
    if (down.size === 0) dragged = null;
    spread = 0;
  };
  lines.addEventListener("pointerup", up);
  lines.addEventListener("pointercancel", up);
  lines.addEventListener("pointerleave", () => {
    pointer = null;
    invalidate();
  });
  lines.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines_ = event.deltaMode === 1 ? 16 : event.deltaMode === 2 ? 400 : 1;
    zoom(Math.exp(-event.deltaY * lines_ * 0.0016), pane, ...place_(event));
  }, { passive: false });
  lines.addEventListener("keydown", (event) => onKey(event, pane));
  lines.addEventListener("focus", invalidate);
  lines.addEventListener("blur", invalidate);
}

function onKey(event, pane) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const step = event.shiftKey ? 8 : 60, keys = {
    ArrowLeft: () => pan(step, 0), ArrowRight: () => pan(-step, 0), ArrowUp: () => pan(0, step), ArrowDown: () => pan(0, -step),
    "+": () => zoom(1.4, pane), "=": () => zoom(1.4, pane), "-": () => zoom(1 / 1.4, pane), 0: fit,
    PageUp: () => cut(Math.min(Number($("height").value) + 1, header.heights.length - 1)),
    PageDown: () => cut(Math.max(Number($("height").value) - 1, 0)),
    a: () => place([view.x, view.y], "start"), b: () => place([view.x, view.y], "goal"), Escape: clearPath,
  };
  const action = keys[event.key] ?? keys[event.key.toLowerCase()];
  if (!action) return;
  event.preventDefault();
  pointer = null;
  action();
}

// Show the slice at one of the heights.
function cut(k) {
  view.z = header.heights[k];
  $("height").value = k;
  $("height-shown").textContent = inSpace ? `${view.z.toFixed(digitsFor(panes[0].lattice))} m` : "";
  invalidate();
}

function listenToPanel() {
  $("fit").addEventListener("click", fit);
  $("nearer").addEventListener("click", () => zoom(1.5, panes[0]));
  $("farther").addEventListener("click", () => zoom(1 / 1.5, panes[0]));
  $("clear").addEventListener("click", clearPath);
  $("play").addEventListener("click", play);
  $("time").addEventListener("input", () => (stopPlaying(), invalidate()));
  for (const id of ["neighbourhood", "radius", "weight", "any-angle"]) $(id).addEventListener("input", plan);
  $("height").addEventListener("input", () => cut(Number($("height").value)));
  $("level").addEventListener("change", () => showLevel(Number($("level").value)));
  for (const role of ["start", "goal"]) {
    const given = () => {
      const point = [$(`${role}-x`), $(`${role}-y`)].map((field) => field.valueAsNumber);
      if (point.every(Number.isFinite)) place(point, role);
    };
    $(`${role}-x`).addEventListener("change", given);
    $(`${role}-y`).addEventListener("change", given);
  }
}

// ---------------------------------------------------------------------- the beginning

async function showLevel(k) {
  await Promise.all(panes.map((pane) => (pane.clear(), pane.show(k))));
  plan();
}

const source = new Blob([$("planner").textContent], { type: "text/javascript" });
const worker = new Worker(URL.createObjectURL(source));
const panes = [...document.querySelectorAll(".pane")].map((figure, k) => new Pane(figure, header.maps[k], String(k)));
worker.onmessage = ({ data }) => {
  panes[Number(data.name)].receive(data);
  report();
};

async function open() {
  readColours();
  listenToPanel();
  panes.forEach(listen);
  if (panes.some((pane) => !pane.drawing.works)) document.documentElement.classList.add("without-webgl");
  panes.forEach((pane) => pane.resize());
  await showLevel(0);
  cut(header.cut);
  fit();
  const watcher = new ResizeObserver(() => {
    // Before the next picture: a canvas that is resized is empty.
    panes.forEach((pane) => (pane.resize(), pane.draw()));
  });
  panes.forEach((pane) => watcher.observe(pane.figure));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => (readColours(), invalidate()));
  requestAnimationFrame(() => {
    document.documentElement.dataset.state = "ready";
    performance.mark("ready");
  });
}

open().catch((error) => {
  document.documentElement.dataset.state = "failed";
  $("status").textContent = `This browser cannot show the map: ${error.message}`;
  document.documentElement.classList.add("without-webgl");
});
