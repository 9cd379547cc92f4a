"use strict";
// What lies over the cells: the trajectory, paths, the two ends, the cell under the pointer, the scale bar.

const MARKER = 9; // pixels, radius of the marks of start and goal

class Overlay {
  constructor(canvas) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
  }

  // Draw what there is to show; "at" takes metres to pixels.
  draw(view, ratio, at, colours, shown) {
    const { pen, canvas } = this;
    this.at = at;
    this.colours = colours;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.lineJoin = pen.lineCap = "round";
    if (shown.trajectory) for (const run of shown.trajectory) this.line(run, colours.trajectory, 1.6);
    if (shown.hovered) this.cell(shown.hovered, view, shown.lattice);
    if (shown.path) {
      this.line(shown.path, colours.halo, 6);
      this.line(shown.path, colours.path, 3);
    }
    this.mark(shown.goal, colours.goal, "B");
    this.mark(shown.start, colours.start, "A");
    if (shown.cross) this.cross(canvas.width / ratio / 2, canvas.height / ratio / 2);
    this.scaleBar(view, canvas.width / ratio, canvas.height / ratio);
  }

  line(points, colour, width) {
    const { pen } = this;
    pen.beginPath();
    points.forEach(([x, y], k) => pen[k ? "lineTo" : "moveTo"](...this.at(x, y)));
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.stroke();
  }

  cell([a, b], view, lattice) {
    if (lattice.resolution * view.scale < 5) return;
    const { pen } = this, [x, y] = lattice.centre(a, b);
    pen.beginPath();
    lattice.numbers.vertices.forEach(([u, v], k) => pen[k ? "lineTo" : "moveTo"](...this.at(x + u, y + v)));
    pen.closePath();
    pen.strokeStyle = this.colours.accent;
    pen.lineWidth = 2;
    pen.stroke();
  }

  mark(point, colour, letter) {
    if (!point) return;
    const { pen } = this, [u, v] = this.at(...point);
    pen.beginPath();
    pen.arc(u, v, MARKER, 0, 2 * Math.PI);
    pen.fillStyle = colour;
    pen.fill();
    pen.strokeStyle = this.colours.halo;
    pen.lineWidth = 2;
    pen.stroke();
    pen.fillStyle = this.colours.halo;
    pen.font = "bold 11px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(letter, u, v + 0.5);
  }

  cross(u, v) {
    const { pen } = this;
    pen.beginPath();
    for (const [x, y] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      pen.moveTo(u + 4 * x, v + 4 * y);
      pen.lineTo(u + 14 * x, v + 14 * y);
    }
    pen.strokeStyle = this.colours.accent;
    pen.lineWidth = 2;
    pen.stroke();
  }

  scaleBar(view, width, height) {
    const { pen } = this, room = Math.min(160, width / 3) / view.scale;
    const power = 10 ** Math.floor(Math.log10(room)), metres = [5, 2, 1].find((m) => m * power <= room) * power;
    const long = metres * view.scale, u = 14, v = height - 16;
    const centimetres = `${+(metres * 100).toPrecision(3)} cm`;
    const text = metres >= 1000 ? `${metres / 1000} km` : metres >= 1 ? `${metres} m` : centimetres;
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "left";
    pen.textBaseline = "alphabetic";
    pen.fillStyle = this.colours.plate;
    pen.fillRect(u - 7, v - 20, Math.max(long, pen.measureText(text).width) + 14, 28);
    pen.fillStyle = this.colours.ink;
    pen.fillText(text, u, v - 6);
    pen.fillRect(u, v - 1, long, 2);
    pen.fillRect(u, v - 4, 1.5, 6);
    pen.fillRect(u + long - 1.5, v - 4, 1.5, 6);
  }
}
