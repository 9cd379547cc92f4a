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
  colours = { lines: names, cells: {} };
  for (const name of ["paper", "free", "wall", "edge", "early", "late"]) {
    const pairs = style.getPropertyValue(`--${name}`).match(/[0-9a-f]{2}/gi);
    colours.cells[name] = pairs.map((pair) => parseInt(pair, 16) / 255);
  }
}

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
      const [x, y] = ends[role]?.map((v) => v.toFixed(2).replace("-0.00", "0.00")) ?? ["", ""];
      $(`${role}-x`).value = x;
      $(`${role}-y`).value = y;
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
  const refused = panes.filter((pane) => pane.answer?.reason);
  const reasons = refused.map(({ map, answer }) => (panes.length > 1 ? `${map.title}: ` : "") + answer.reason);
  const blind = panes.some((pane) => !pane.drawing.works);
  let advice = reasons.join(" ") || "Drag A or B to move an end of the path.";
  if (!ends.goal) advice = "Now the goal.";
  if (!ends.start) advice = "Click or tap to set the start.";
  if (blind && !(ends.start && ends.goal)) advice = "Without WebGL 2 there is a picture only: give both ends in numbers.";
  $("status").textContent = advice;
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
