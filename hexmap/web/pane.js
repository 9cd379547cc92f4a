"use strict";
// A pane: one map under the view that all share, what is asked of the planner for it, and what it says of a cell.

// Digits behind the point, so that a tenth of a cell shows.
const digitsFor = (lattice) => Math.max(2, Math.ceil(1 - Math.log10(lattice.resolution)));

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
    if (!this.loaded.has(k)) {
      const bytes = await unpack($(`cells-${this.name}-${k}`).textContent);
      this.loaded.set(k, new Cells(numbers, bytes, this.map.rule));
    }
    this.numbers = numbers;
    this.lattice = inSpace ? new SpatialLattice(numbers) : new Lattice(numbers);
    this.cells = this.loaded.get(k);
    if (this.drawing.works) this.drawing.setLevel(this.lattice, this.cells);
    if (inSpace) return;
    worker.postMessage({ kind: "level", name: this.name, numbers, tiles: this.cells.states, settings: settings() });
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
    const byKeys = this.lines.matches(":focus-visible"), middle = byKeys ? [view.x, view.y] : null;
    const point = pointer ? pointer.pane.toMetres(...pointer.at) : middle;
    const hovered = point && this.lattice.quantise(...point, view.z);
    this.overlay.draw(view, ratio, (x, y) => this.toPixels(x, y), colours.lines, {
      trajectory, hovered: inSpace ? null : hovered, lattice: this.lattice, path: this.path, ...this.shownEnds(),
      cross: pointer === null && byKeys,
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
    const words = ["unknown", "free", "occupied"][state];
    this.caption.textContent = `${metres} m · cell (${cell.join(", ")}) ${words}${counts}`;
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
