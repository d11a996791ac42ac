// Epipolar plane images directly under and beside the view, in line with its pixels.

import { asCanvas, paintView } from "./colours.js";
import { fitted, stroke } from "./elements.js";
import { mark } from "./picture.js";
import { array, newest } from "./server.js";

export class Epi {
  #found = null;

  /**
   * @param canvas
   * @param along  "row" or "column"
   * @param view  the picture of the view
   * @param now  () => { lf, pixel, disparity, tested, hidden, look, current }
   * @param choose  called with (index of a view, pixel along the EPI)
   * @param test  called with the disparity of the line to where somebody drags
   */
  constructor(canvas, along, view, now, choose, test) {
    Object.assign(this, { canvas, along, view, now, choose, test, isRow: along === "row" });
    this.ask = newest((query) => array("epi", query), (found, query) => {
      this.#found = { ...found, at: query.at, key: query.key };
      this.draw();
    });
    new ResizeObserver(() => {
      fitted(canvas);
      this.draw();
    }).observe(canvas);
    view.viewport.onChange(() => this.draw());
    let begin = null, isDrag = false;
    canvas.addEventListener("pointerdown", (event) => {
      begin = event;
      isDrag = false;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!begin || !event.buttons) return;
      isDrag ||= Math.hypot(event.clientX - begin.clientX, event.clientY - begin.clientY) > 5;
      if (isDrag) this.#dragged(event);
    });
    canvas.addEventListener("pointerup", (event) => {
      if (begin && !isDrag) this.#clicked(event);
      begin = null;
    });
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
    const { canvas, isRow } = this, context = canvas.getContext("2d"), { lf, pixel, disparity, tested, hidden, look, current } = this.now();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    canvas.dataset.drawn = "";
    if (!lf || !this.#found || !pixel) return;
    const { data, shape } = this.#found, views = this.#views(), place = this.view.viewport.place(this.view);
    if (shape[0] !== views.length) return;
    const { thick, start } = this.#layout(views.length), begin = isRow ? place.left : place.top;
    const looks = `${look.exposure} ${look.gamma}`;
    if (this.#found.looks !== looks) Object.assign(this.#found, { epi: asCanvas(paintView(data, shape, look)), looks });
    if (!isRow) context.setTransform(0, 1, 1, 0, 0, 0); // columns run down
    context.imageSmoothingEnabled = false;
    context.drawImage(this.#found.epi, begin, start, shape[1] * place.scale, thick * views.length);
    const ratio = window.devicePixelRatio, axis = isRow ? 0 : 1;
    const ahead = (value) => views.map((index, k) => [
      begin + (pixel[axis] + 0.5 - value * lf.offsets[index][axis]) * place.scale, start + (k + 0.5) * thick,
    ]);
    for (const [value, style] of [[disparity, mark()], [tested, "#fff"]]) {
      const line = new Path2D();
      if (Number.isFinite(value)) ahead(value).forEach((at) => line.lineTo(...at));
      stroke(context, line, ["rgb(0 0 0 / 70%)", 5], [style, 2.5]);
    }
    Object.assign(context, { fillStyle: "#fff", strokeStyle: "#000", lineWidth: 3 * ratio, font: `bold ${16 * ratio}px sans-serif`, textAlign: "center", textBaseline: "middle" });
    if (Number.isFinite(disparity)) ahead(disparity).forEach(([x, y], k) => { // a cross where the map has something in front
      if (hidden.includes(views[k])) context.strokeText("×", x, y), context.fillText("×", x, y);
    });
    const row = views.indexOf(current);
    if (row >= 0 && thick > 3) { // the view that is shown
      const length = Math.min(isRow ? canvas.width : canvas.height, shape[1] * place.scale);
      context.strokeStyle = "rgb(255 255 255 / 80%)";
      context.lineWidth = ratio;
      context.strokeRect(Math.max(0, begin) + 0.5, start + row * thick + 0.5, length - 1, thick - 1);
    }
    canvas.dataset.drawn = `${this.#found.key} ${this.#found.at}`;
  }

  /** Where somebody points: how many pixels along the EPI, and the view. */
  #spot(event) {
    const box = this.canvas.getBoundingClientRect(), ratio = this.canvas.width / box.width;
    const spot = [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
    if (!this.isRow) spot.reverse();
    const place = this.view.viewport.place(this.view), { thick, start } = this.#layout(this.#views().length);
    return [(spot[0] - (this.isRow ? place.left : place.top)) / place.scale, Math.floor((spot[1] - start) / thick)];
  }

  #dragged(event) {
    const { lf, pixel } = this.now();
    if (!lf || !pixel) return;
    const views = this.#views(), axis = this.isRow ? 0 : 1, [at, row] = this.#spot(event);
    const step = lf.offsets[views[Math.min(Math.max(row, 0), views.length - 1)]][axis];
    if (Math.abs(step) > 0.5) this.test((pixel[axis] + 0.5 - at) / step);
  }

  #clicked(event) {
    const { lf, pixel } = this.now();
    if (!lf || !pixel || !this.#found) return;
    const views = this.#views(), side = this.view.viewport.size[this.isRow ? 1 : 0], [at, row] = this.#spot(event);
    if (at >= 0 && at < side && row >= 0 && row < views.length) this.choose(views[row], Math.floor(at));
  }
}
