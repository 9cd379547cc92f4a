"use strict";
// Cells by WebGL2: one rectangle, whose every pixel is quantised onto the lattice and looks its cell up in a texture.

// The numbers of the lattice are written into the program: it is compiled once a level. A lattice of space is cut
// horizontally: of each pixel's point, whose height is that of the slice, the nearest centre in space is found.
function fragmentProgram(lattice) {
  const { drawn, faces } = lattice.numbers, n = lattice.numbers.basis.length, space = n === 3;
  const metres = (v) => lattice.numbers.basis.map((row) => row.reduce((sum, x, k) => sum + x * v[k], 0));
  // Of opposite faces one: the normals in the plane that is drawn, and how far the faces are from the centre in it. A
  // face that lies flat is no border in a horizontal plane.
  const normals = [], halves = [];
  for (const v of faces.filter((face) => face.find((x) => x !== 0) > 0).map(metres)) {
    const across = Math.hypot(v[0], v[1]), squared = v.reduce((sum, x) => sum + x * x, 0);
    if (across <= 1e-6 * Math.sqrt(squared)) continue;
    normals.push(v.map((x) => x / across));
    halves.push([(0.5 * squared) / across]);
  }
  const vec = (v) => (v.length > 1 ? `vec${v.length}` : "float") + `(${v.map((x) => x.toExponential(9)).join(", ")})`;
  const list = (name, v) => {
    const type = v[0].length > 1 ? `vec${v[0].length}` : "float";
    return `const ${type} ${name}[${v.length}] = ${type}[](${v.map(vec).join(", ")});`;
  };
  return `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2DArray;
precision highp usampler2D;
precision highp usampler3D;
${list("CANDIDATES", drawn)}
${list("CENTRES", drawn.map(metres))}
${list("NORMALS", normals)}
${list("HALVES", halves)}
uniform usampler2DArray states;
uniform usampler3D tiles;
uniform usampler2D entered;
uniform mat${n} basis, inverse;
uniform vec${n} fraction;
uniform vec2 middle, metresPerPixel;
uniform ivec${n} centre;
uniform ivec3 tableLow, tableShape;
uniform ivec2 enteredLow, enteredShape;
uniform int shift, abreast, detail, enteredShift;
uniform float outline, now;
uniform vec3 paper, free, wall, edge, early, late;
out vec4 colour;

uint stateOf(ivec3 cell) {
  ivec3 tile = ivec3(cell.xy >> shift, cell.z) - tableLow;
  if (any(lessThan(tile, ivec3(0))) || any(greaterThanEqual(tile, tableShape))) return 0u;
  int number = int(texelFetch(tiles, tile.zyx, 0).r) - 1;
  if (number < 0) return 0u;
  ivec2 corner = ivec2(number / abreast % abreast, number % abreast) << shift;
  ivec2 at = (corner + (cell.xy & ((1 << shift) - 1))) >> detail;
  return texelFetch(states, ivec3(at.yx, number / (abreast * abreast)), detail).r;
}

float timeOf(ivec2 cell) {
  ivec2 at = (cell - enteredLow) >> enteredShift;
  if (any(lessThan(at, ivec2(0))) || any(greaterThanEqual(at, enteredShape))) return 0.0;
  return float(texelFetch(entered, at.yx, 0).r) / 65535.0;
}

void main() {
  // Coordinates relative to the cell at the view's centre: near it they are exact however far away the origin is.
  vec2 away = (gl_FragCoord.xy - middle) * metresPerPixel;
  vec${n} u = fraction + inverse * ${space ? "vec3(away, 0.0)" : "away"};
  vec${n} low = floor(u), rest = basis * (u - low), found = vec${n}(0.0), off = found;
  float best = 1e30;
  for (int k = 0; k < CANDIDATES.length(); k++) {
    vec${n} x = rest - CENTRES[k];
    float d = dot(x, x);
    if (d < best) { best = d; found = CANDIDATES[k]; off = x; }
  }
  ivec${n} cell = centre + ivec${n}(low) + ivec${n}(found);
  uint state = stateOf(${space ? "cell" : "ivec3(cell, 0)"});
  vec3 shade = state == 2u ? wall : state == 1u ? free : paper;
  float time = timeOf(cell.xy);
  if (time > 0.0 && time <= now && state != 2u) shade = mix(shade, mix(early, late, time), 0.75);
  if (outline > 0.0) {
    float border = 1e30;
    for (int k = 0; k < HALVES.length(); k++) border = min(border, HALVES[k] - abs(dot(off, NORMALS[k])));
    float line = 1.0 - smoothstep(0.4, 1.2, border / abs(metresPerPixel.x));
    shade = mix(shade, edge, line * outline * (state == 0u ? 0.35 : 0.8));
  }
  colour = vec4(shade, 1.0);
}`;
}

const VERTEX_PROGRAM = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;

// A matrix as WebGL takes it, from its rows.
function columnsOf(rows) {
  return rows.map((_, k) => rows.map((row) => row[k])).flat();
}

class CellDrawing {
  constructor(canvas) {
    this.gl = canvas.getContext("webgl2", { alpha: false, antialias: false, powerPreference: "low-power" });
    if (!this.gl) return;
    this.canvas = canvas;
    this.most = this.gl.getParameter(this.gl.MAX_TEXTURE_SIZE);
    this.textures = {};
  }

  get works() {
    return this.gl !== null;
  }

  // Forget what belonged to a context that was lost.
  forget() {
    this.program = null;
    this.textures = {};
  }

  compile(kind, source) {
    const { gl } = this, shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) ?? "no shader");
    return shader;
  }

  // Show the cells of a level.
  setLevel(lattice, cells) {
    const { gl } = this;
    if (this.program) gl.deleteProgram(this.program);
    this.lattice = lattice;
    this.cells = cells;
    this.program = gl.createProgram();
    gl.attachShader(this.program, this.compile(gl.VERTEX_SHADER, VERTEX_PROGRAM));
    gl.attachShader(this.program, this.compile(gl.FRAGMENT_SHADER, fragmentProgram(lattice)));
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(this.program));
    this.places = new Map();
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    let { states, side, layers } = cells.sheets();
    this.texture("states", 0, gl.TEXTURE_2D_ARRAY);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, cells.details + 1, gl.R8UI, side, side, layers);
    for (let detail = 0; detail <= cells.details; detail++) {
      if (detail > 0) [states, side] = halved(states, side);
      gl.texSubImage3D(
        gl.TEXTURE_2D_ARRAY, detail, 0, 0, 0, side, side, layers, gl.RED_INTEGER, gl.UNSIGNED_BYTE, states,
      );
    }
    this.texture("tiles", 1, gl.TEXTURE_3D);
    const [a, b, c] = cells.tableShape;
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.R16UI, c, b, a, 0, gl.RED_INTEGER, gl.UNSIGNED_SHORT, cells.table);
    this.setEntered(null);
  }

  texture(name, unit, target) {
    const { gl } = this;
    if (this.textures[name]) gl.deleteTexture(this.textures[name]);
    this.textures[name] = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(target, this.textures[name]);
    gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, name === "states" ? gl.NEAREST_MIPMAP_NEAREST : gl.NEAREST);
    gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texParameteri(target, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  }

  // Tint cells in the order in which a search entered them: pairs of indices, or null.
  setEntered(pairs) {
    const { gl } = this;
    let low = [0, 0], high = [-1, -1];
    if (pairs && pairs.length) {
      low = [Infinity, Infinity];
      high = [-Infinity, -Infinity];
      for (let k = 0; k < pairs.length; k++) {
        low[k % 2] = Math.min(low[k % 2], pairs[k]);
        high[k % 2] = Math.max(high[k % 2], pairs[k]);
      }
    }
    let shift = 0;
    while (Math.max(high[0] - low[0], high[1] - low[1]) >> shift >= this.most) shift++;
    const shape = [0, 1].map((k) => Math.max(1, ((high[k] - low[k]) >> shift) + 1));
    const times = new Uint16Array(shape[0] * shape[1]), count = pairs ? pairs.length / 2 : 0;
    for (let k = count - 1; k >= 0; k--) {
      const at = ((pairs[2 * k] - low[0]) >> shift) * shape[1] + ((pairs[2 * k + 1] - low[1]) >> shift);
      times[at] = 1 + Math.floor((65534 * k) / count);
    }
    this.entered = { low, shape: count ? shape : [0, 0], shift };
    this.texture("entered", 2, gl.TEXTURE_2D);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R16UI, shape[1], shape[0], 0, gl.RED_INTEGER, gl.UNSIGNED_SHORT, times);
  }

  set(kind, name, ...values) {
    if (!this.places.has(name)) this.places.set(name, this.gl.getUniformLocation(this.program, name));
    this.gl[kind](this.places.get(name), ...values);
  }

  // The level of detail of a view, whose boxes are as high as a pixel at least, so that each of them meets one.
  detailFor(view, ratio) {
    return Math.max(0, Math.min(this.cells.details, Math.ceil(-Math.log2(view.scale * ratio * this.lattice.height))));
  }

  // Draw a view: its centre in metres, pixels of the screen a metre, and whether y grows downwards.
  draw(view, ratio, detail, colours, now) {
    const { gl, canvas, lattice, cells } = this;
    if (!this.program) return;
    const metres = 1 / (view.scale * ratio), u = lattice.coordinates(view.x, view.y, view.z), n = u.length;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.useProgram(this.program);
    this.set("uniform1i", "states", 0);
    this.set("uniform1i", "tiles", 1);
    this.set("uniform1i", "entered", 2);
    this.set(`uniformMatrix${n}fv`, "basis", false, columnsOf(lattice.numbers.basis));
    this.set(`uniformMatrix${n}fv`, "inverse", false, columnsOf(lattice.inverse));
    this.set("uniform2f", "middle", canvas.width / 2, canvas.height / 2);
    this.set("uniform2f", "metresPerPixel", metres, view.down ? -metres : metres);
    this.set(`uniform${n}iv`, "centre", u.map(Math.floor));
    this.set(`uniform${n}fv`, "fraction", u.map((v) => v - Math.floor(v)));
    this.set("uniform1i", "shift", cells.shift);
    this.set("uniform1i", "abreast", cells.abreast);
    this.set("uniform3iv", "tableLow", cells.tableLow);
    this.set("uniform3iv", "tableShape", cells.tableShape);
    this.set("uniform2i", "enteredLow", ...this.entered.low);
    this.set("uniform2i", "enteredShape", ...this.entered.shape);
    this.set("uniform1i", "enteredShift", this.entered.shift);
    this.set("uniform1f", "now", now);
    this.set("uniform1i", "detail", Math.min(cells.details, detail));
    const wide = lattice.resolution * view.scale;
    this.set("uniform1f", "outline", Math.max(0, Math.min(1, (wide - 7) / 9)));
    for (const [name, colour] of Object.entries(colours)) this.set("uniform3f", name, ...colour);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
