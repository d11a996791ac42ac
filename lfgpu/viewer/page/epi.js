// Epipolar plane images directly under and beside the view, in line with its pixels.

import { paintView } from "./colours.js";
import { mark } from "./picture.js";
import { array, newest } from "./server.js";

export class Epi {
  #found = null;

  /**
   * @param canvas
   * @param along  "row" or "column"
   * @param view  the picture of the view
   * @param now  () => { lf, pixel, disparity, look, current }
   * @param choose  called with (index of a view, pixel along the EPI)
   */
  constructor(canvas, along, view, now, choose) {
    Object.assign(this, { canvas, along, view, now, choose, isRow: along === "row" });
    this.ask = newest((query) => array("epi", query), (found, query) => {
      this.#found = { ...found, at: query.at, key: query.key };
      this.draw();
    });
    new ResizeObserver(() => {
      const ratio = window.devicePixelRatio;
      canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
      canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
      this.draw();
    }).observe(canvas);
    view.viewport.onChange(() => this.draw());
    canvas.addEventListener("click", (event) => this.#clicked(event));
  }

  /** Ask for the EPI through a pixel, of the views of a state of the server. */
  fetch(at, { views: key, revision: of }) {
    if (this.#found?.at !== at || this.#found?.key !== key) this.ask({ along: this.along, at, key, of });
    else this.draw();
  }

  draw() {
    if (this.drawing) return;
    this.drawing = requestAnimationFrame(() => {
      this.drawing = 0;
      this.#drawNow();
    });
  }

  /** Thickness of each view on the canvas, and where the first one begins. */
  #layout(count) {
    const room = this.isRow ? this.canvas.height : this.canvas.width, thick = Math.max(1, Math.floor(room / count));
    return { thick, start: Math.floor(Math.max(0, room - thick * count) / 2) };
  }

  #views() {
    const { lf } = this.now();
    return this.isRow ? lf.row : lf.column;
  }

  #drawNow() {
    const { canvas, isRow } = this, context = canvas.getContext("2d"), { lf, pixel, disparity, look, current } = this.now();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    canvas.dataset.drawn = "";
    if (!lf || !this.#found || !pixel) return;
    const { data, shape } = this.#found, views = this.#views(), place = this.view.viewport.place(this.view);
    if (shape[0] !== views.length) return;
    const { thick, start } = this.#layout(views.length), begin = isRow ? place.left : place.top;
    const looks = `${look.exposure} ${look.gamma}`;
    if (this.#found.looks !== looks) {
      const epi = Object.assign(document.createElement("canvas"), { width: shape[1], height: shape[0] });
      epi.getContext("2d").putImageData(paintView(data, shape, look), 0, 0);
      Object.assign(this.#found, { epi, looks });
    }
    if (!isRow) context.setTransform(0, 1, 1, 0, 0, 0); // columns run down
    context.imageSmoothingEnabled = false;
    context.drawImage(this.#found.epi, begin, start, shape[1] * place.scale, thick * views.length);
    const ratio = window.devicePixelRatio, axis = isRow ? 0 : 1;
    if (Number.isFinite(disparity)) {
      const points = views.map((index, k) => [
        begin + (pixel[axis] + 0.5 - disparity * lf.offsets[index][axis]) * place.scale, start + (k + 0.5) * thick,
      ]);
      for (const [style, wide] of [["rgb(0 0 0 / 70%)", 5 * ratio], [mark(), 2.5 * ratio]]) {
        context.strokeStyle = style;
        context.lineWidth = wide;
        context.beginPath();
        points.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
        context.stroke();
      }
    }
    const row = views.indexOf(current);
    if (row >= 0 && thick > 3) { // the view that is shown
      const length = Math.min(isRow ? canvas.width : canvas.height, shape[1] * place.scale);
      context.strokeStyle = "rgb(255 255 255 / 80%)";
      context.lineWidth = ratio;
      context.strokeRect(Math.max(0, begin) + 0.5, start + row * thick + 0.5, length - 1, thick - 1);
    }
    canvas.dataset.drawn = `${this.#found.key} ${this.#found.at}`;
  }

  #clicked(event) {
    const { lf, pixel } = this.now();
    if (!lf || !pixel || !this.#found) return;
    const box = this.canvas.getBoundingClientRect(), ratio = this.canvas.width / box.width;
    const spot = [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
    if (!this.isRow) spot.reverse();
    const views = this.#views(), place = this.view.viewport.place(this.view), { thick, start } = this.#layout(views.length);
    const side = this.view.viewport.size[this.isRow ? 1 : 0];
    const at = Math.floor((spot[0] - (this.isRow ? place.left : place.top)) / place.scale);
    const row = Math.floor((spot[1] - start) / thick);
    if (at >= 0 && at < side && row >= 0 && row < views.length) this.choose(views[row], at);
  }
}
