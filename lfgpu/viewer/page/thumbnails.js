// All views, small, where their cameras stand; the current one has a frame, the reference view a dot.

import { array } from "./server.js";
import { asCanvas, paintView } from "./colours.js";
import { stroke } from "./elements.js";
import { drawDot, mark } from "./picture.js";

const LEAST = 12; // pixels of a cell: smaller ones are put in lines one below the other

export class Thumbnails {
  #sprites = [];
  key = null;
  #boxes = [];
  #grid = null; // all of them, as they were painted last
  #painted = "";

  /** @param now  () => { lf, current, look };  @param choose  called with the index of a view */
  constructor(canvas, now, choose) {
    Object.assign(this, { canvas, now, choose });
    canvas.addEventListener("click", (event) => {
      const box = canvas.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
      const found = this.#boxes.findIndex(([left, top, wide, high]) => x >= left && y >= top && x < left + wide && y < top + high);
      if (found >= 0) choose(found);
    });
  }

  async fetch(key, of) {
    if (key === this.key) return this.draw();
    this.key = key;
    let found;
    try {
      found = await array("thumbnails", { of });
    } catch { // the server has gone, or what was asked for has: the next state asks again
      if (key === this.key) this.key = null;
      return undefined;
    }
    if (key !== this.key) return undefined;
    const { data, shape: [count, height, width] } = found;
    this.#sprites = Array.from({ length: count }, (_, n) => ({
      data: data.subarray(n * height * width * 3, (n + 1) * height * width * 3), shape: [height, width, 3],
    }));
    return this.draw();
  }

  draw() {
    const { canvas } = this, { lf, current, look } = this.now();
    if (!lf || this.#sprites.length !== lf.views) return;
    const ratio = window.devicePixelRatio, room = canvas.parentElement.clientWidth || 260;
    const [height, width] = this.#sprites[0].shape, tall = matchMedia("(max-width: 760px)").matches ? 150 : matchMedia("(max-height: 760px)").matches ? 176 : 264;
    const { cells, wide, high, columns, rows } = layout(lf, Math.min(room, 264), tall, height / width);
    Object.assign(canvas.style, { width: `${columns * wide}px`, height: `${rows * high}px` });
    canvas.width = Math.round(columns * wide * ratio);
    canvas.height = Math.round(rows * high * ratio);
    this.#boxes = cells.map(([column, row]) => [column * wide, row * high, wide, high]);
    const painted = `${this.key} ${look.exposure} ${look.gamma} ${canvas.width} ${canvas.height}`;
    if (painted !== this.#painted) {
      this.#grid = Object.assign(document.createElement("canvas"), { width: canvas.width, height: canvas.height });
      const grid = this.#grid.getContext("2d");
      grid.scale(ratio, ratio);
      this.#boxes.forEach(([left, top], n) => {
        grid.drawImage(asCanvas(paintView(this.#sprites[n].data, this.#sprites[n].shape, look)), left + 0.5, top + 0.5, wide - 1, high - 1);
      });
      this.#painted = painted;
    }
    const context = canvas.getContext("2d");
    context.drawImage(this.#grid, 0, 0);
    const [dot, box] = [lf.reference, current].map((n) => this.#boxes[n].map((side) => side * ratio)), frame = new Path2D(), inset = 1.5 * ratio;
    drawDot(context, { left: dot[0] + dot[2] / 2, top: dot[1] + dot[3] / 2, scale: 0 }, 0, 0, Math.max(2, Math.min(wide, high) * 0.12));
    frame.rect(box[0] + inset, box[1] + inset, box[2] - 2 * inset, box[3] - 2 * inset);
    stroke(context, frame, ["#fff", 4], [mark(), 2.5]);
    canvas.dataset.drawn = `${this.key} ${current}`;
  }
}

/** Where each view is drawn: [column, row] in cells, and the size of a cell. */
function layout(lf, room, tall, aspect) {
  const us = lf.positions.map(([u]) => u), vs = lf.positions.map(([, v]) => v);
  const [left, top] = [Math.min(...us), Math.min(...vs)];
  let columns = Math.max(...us) - left + 1, rows = Math.max(...vs) - top + 1;
  const size = (columns, rows) => {
    const wide = Math.min(room / columns, tall / rows / aspect, 72);
    return { wide, high: wide * aspect };
  };
  const { wide, high } = size(columns, rows);
  const apart = Math.min(...lf.positions.slice(1).map(([u, v], n) => Math.max(Math.abs(u - us[n]), Math.abs(v - vs[n]))));
  if (wide >= LEAST && apart > 0.9) return { cells: lf.positions.map(([u, v]) => [u - left, v - top]), wide, high, columns, rows };
  columns = Math.max(1, Math.ceil(Math.sqrt((lf.views * aspect * room) / tall)));
  rows = Math.ceil(lf.views / columns);
  return { cells: us.map((_, n) => [n % columns, Math.floor(n / columns)]), ...size(columns, rows), columns, rows };
}

/** The next view in a direction (du, dv), or the same one at the border. */
export function neighbour(lf, current, du, dv) {
  const [u, v] = lf.positions[current];
  let best = current, least = Infinity;
  lf.positions.forEach(([a, b], n) => {
    const ahead = (a - u) * du + (b - v) * dv, beside = Math.abs((a - u) * dv) + Math.abs((b - v) * du);
    if (ahead > 1e-6 && beside <= ahead && ahead + 3 * beside < least) [best, least] = [n, ahead + 3 * beside];
  });
  return best;
}
