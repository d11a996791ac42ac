// A canvas that shows a picture of tiles, moves and enlarges it, and tells where somebody points.

import { fitted, number, stroke } from "./elements.js";
import { coarsest, numbers, sideAt, tile, want } from "./tiles.js";

const LEGIBLE = 34; // pixels of the screen for one of a map: its value can be written there
const CLICK = 5; // pixels: who moves less has clicked
const GRIP = 14; // pixels beside the line of a wipe where it can be taken
const NEARLY = 1.25; // enlargement at which what is computed still looks sharp
const CALM = 400; // milliseconds without a change, after which it is computed as fine as the screen

export class Picture {
  #sources = []; // one, or two that a wipe divides
  #before = null; // what was drawn last, until the next one has come
  #pointers = new Map();
  #sharpen = 0;
  #complete = true;

  /**
   * @param canvas
   * @param viewport  shared by all pictures that move together
   * @param on  { point(x, y or null), choose(x, y), grasp(), drag(dx, dy, event, from, to), wipe(share), overlay(context, place),
   *   complete(), next() }; `drag`, which knows the pixels, returns whether it did something, else the picture moves; `next` gives the sources that are
   *   probably looked at next
   */
  constructor(canvas, viewport, on) {
    Object.assign(this, { canvas, viewport, on, wipe: 0.36, isSharp: false });
    viewport.onChange(() => this.draw());
    new ResizeObserver(() => this.#resized()).observe(canvas);
    this.#listen();
  }

  /** Show one source, or two beside each other. */
  show(...sources) {
    if (sources[0]?.key !== this.#sources[0]?.key) {
      this.isSharp = false;
      clearTimeout(this.#sharpen);
    }
    this.#sources = sources.filter(Boolean);
    this.#complete = !this.#sources.length;
    this.draw();
  }

  /** Whether all that is wanted is drawn, as far as it can be seen. */
  get isComplete() {
    return this.#complete || !this.canvas.offsetParent;
  }

  draw() {
    if (this.drawing) return;
    this.drawing = requestAnimationFrame(() => {
      this.drawing = 0;
      this.#drawNow();
    });
  }

  #resized() {
    fitted(this.canvas);
    this.viewport.changed();
    this.#drawNow(); // else the empty canvas would be seen
  }

  #drawNow() {
    const { canvas } = this, context = canvas.getContext("2d");
    context.clearRect(0, 0, canvas.width, canvas.height);
    if (!this.#sources.length || canvas.width < 2) {
      want(this, []);
      canvas.dataset.drawn = "";
      return;
    }
    const place = this.viewport.place(this), wishes = [];
    const [first, second] = this.#sources;
    const edge = second ? Math.round(place.left + this.wipe * first.size[1] * place.scale) : canvas.width;
    let complete = this.#drawPart(context, place, first, 0, edge, wishes);
    if (second) complete = this.#drawPart(context, place, second, edge, canvas.width, wishes) && complete;
    if (!second && first.isMap && place.scale >= LEGIBLE * window.devicePixelRatio) this.#drawNumbers(context, place, first);
    if (complete && !first.isComputed && !first.draw) {
      const next = this.on.next?.() ?? [];
      wishes.push(...next.flatMap((source) => wishes.slice().map(([, ...place]) => [source, ...place])));
    }
    want(this, wishes);
    if (complete && !first.draw) this.#before = first;
    this.#complete = complete;
    canvas.dataset.drawn = complete ? this.#sources.map(({ key, look }) => `${key} ${look}`).join(" / ") : "";
    Object.assign(canvas.dataset, { left: place.left, top: place.top, scale: place.scale });
    this.on.overlay?.(context, place);
    if (!complete && first.isComputed) drawNote(context, "Computing …");
    if (second) this.#drawWipe(context, edge);
    if (complete) this.on.complete?.();
  }

  /** Draw a source between two columns of the canvas; returns whether all of it has come. */
  #drawPart(context, place, source, from, to, wishes) {
    context.save();
    context.beginPath();
    context.rect(from, 0, to - from, context.canvas.height);
    context.clip();
    const draw = source.draw ? this.#drawWhole : source.isComputed ? this.#drawComputed : this.#drawStored;
    const complete = draw.call(this, context, place, source, wishes);
    context.restore();
    return complete;
  }

  /** Write the value of each pixel that is seen on it. */
  #drawNumbers(context, place, source) {
    const side = sideAt(source, 0), seen = (start, room, most) => [Math.max(0, Math.floor(-start / place.scale)), Math.min(most, Math.ceil((room - start) / place.scale))];
    const [left, right] = seen(place.left, context.canvas.width, source.size[1]), [top, bottom] = seen(place.top, context.canvas.height, source.size[0]);
    Object.assign(context, { font: `${11 * window.devicePixelRatio}px system-ui, sans-serif`, textAlign: "center", textBaseline: "middle", strokeStyle: "#000", fillStyle: "#fff", lineWidth: 3 });
    for (let y = top; y < bottom; y++) {
      for (let x = left; x < right; x++) {
        const found = numbers(source, 0, Math.floor(x / side), Math.floor(y / side)), value = found?.data[(y % side) * found.shape[1] + (x % side)];
        const words = [Number.isFinite(value) ? number(value, 3) : "", place.left + (x + 0.5) * place.scale, place.top + (y + 0.5) * place.scale];
        context.strokeText(...words);
        context.fillText(...words);
      }
    }
    context.textAlign = "start";
  }

  /** Draw what the page draws itself, if that can be done yet. */
  #drawWhole(context, place, source) {
    const picture = source.draw();
    context.imageSmoothingEnabled = place.scale < 2;
    if (picture) context.drawImage(picture, place.left, place.top, place.width, place.height);
    else this.#drawBefore(context, place, source.size);
    return Boolean(picture);
  }

  /** Draw the tiles of a level that are seen and have come; returns whether all have. `wishes` gets all that are seen. */
  #drawLevel(context, place, source, level, wishes) {
    const [height, width] = source.size, step = sideAt(source, level) * 2 ** level;
    const range = (start, room, side) => [
      Math.max(0, Math.floor(-start / place.scale / step)),
      Math.min(Math.ceil(side / step), Math.ceil((room - start) / place.scale / step)),
    ];
    const [left, right] = range(place.left, context.canvas.width, width);
    const [top, bottom] = range(place.top, context.canvas.height, height);
    let complete = true;
    for (let row = top; row < bottom; row++) {
      for (let column = left; column < right; column++) {
        const found = tile(source, level, column, row);
        if (found) this.#put(context, place, source, found, column * step, row * step, 2 ** level);
        else complete = false;
        wishes?.push([source, level, column, row]);
      }
    }
    return complete;
  }

  /** The coarsest level whose pixels are enlarged at most so much. */
  #levelFor(place, source, enlargement) {
    return Math.min(coarsest(source), Math.max(0, Math.floor(Math.log2(enlargement / place.scale) + 1e-6)));
  }

  /** Draw what was drawn last, as far as it is still there. */
  #drawBefore(context, place, size) {
    const before = this.#before;
    if (before?.size.join() !== size.join()) return;
    this.#drawLevel(context, place, before, coarsest(before), null);
    this.#drawLevel(context, place, before, this.#levelFor(place, before, before.isComputed ? NEARLY : 1), null);
  }

  #drawStored(context, place, source, wishes) {
    const most = coarsest(source), level = this.#levelFor(place, source, 1), overview = tile(source, most, 0, 0), own = [];
    if (!overview) this.#drawBefore(context, place, source.size);
    if (overview && level < most) this.#put(context, place, source, overview, 0, 0, 2 ** most);
    const complete = this.#drawLevel(context, place, source, level, own);
    if (!complete && level < most) wishes.push([source, most, 0, 0]);
    wishes.push(...own);
    return complete;
  }

  /** What the server computes comes coarse first, and as fine as the screen when nothing has changed for a while. */
  #drawComputed(context, place, source, wishes) {
    const most = coarsest(source), level = this.#levelFor(place, source, NEARLY);
    const overview = tile(source, most, 0, 0);
    if (!overview) this.#drawBefore(context, place, source.size);
    else this.#put(context, place, source, overview, 0, 0, 2 ** most);
    wishes.push([source, most, 0, 0]);
    if (overview && level < most) {
      this.#drawLevel(context, place, source, level, this.isSharp ? wishes : null);
      if (!this.isSharp) {
        clearTimeout(this.#sharpen);
        this.#sharpen = setTimeout(() => {
          this.isSharp = true;
          this.draw();
        }, CALM);
      }
    }
    return Boolean(overview);
  }

  #put(context, place, source, image, x, y, step) {
    const at = (start, value) => Math.round(start + value * place.scale);
    const left = at(place.left, x), top = at(place.top, y);
    const right = at(place.left, Math.min(x + image.width * step, source.size[1]));
    const bottom = at(place.top, Math.min(y + image.height * step, source.size[0]));
    const enlargement = place.scale * step;
    context.imageSmoothingEnabled = !source.isMap && enlargement < 2 && !Number.isInteger(enlargement);
    context.imageSmoothingQuality = "high";
    const [seenX, seenY] = [(source.size[1] - x) / step, (source.size[0] - y) / step];
    context.drawImage(
      image, 0, 0, Math.min(image.width, seenX), Math.min(image.height, seenY), left, top, right - left, bottom - top,
    );
  }

  #drawWipe(context, edge) {
    const ratio = window.devicePixelRatio, { height } = context.canvas;
    context.fillStyle = "rgb(0 0 0 / 55%)";
    context.fillRect(edge - 2 * ratio, 0, 4 * ratio, height);
    context.fillStyle = "#fff";
    context.fillRect(edge - ratio, 0, 2 * ratio, height);
    context.beginPath();
    context.arc(edge, height / 2, 11 * ratio, 0, 7);
    context.fill();
    Object.assign(context, { fillStyle: "#333", font: `${15 * ratio}px sans-serif`, textAlign: "center", textBaseline: "middle" });
    context.fillText("↔", edge, height / 2);
    context.textAlign = "start";
  }

  // --- pointing ---

  /** The place of a pointer on the canvas, in its pixels. */
  #spot(event) {
    const box = this.canvas.getBoundingClientRect(), ratio = this.canvas.width / box.width;
    return [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
  }

  /** The pixel of the picture at a place of the canvas; null beside the picture. */
  pixel([x, y]) {
    if (!this.#sources.length) return null;
    const place = this.viewport.place(this), [height, width] = this.#sources[0].size;
    const at = [Math.floor((x - place.left) / place.scale), Math.floor((y - place.top) / place.scale)];
    return at[0] >= 0 && at[1] >= 0 && at[0] < width && at[1] < height ? at : null;
  }

  #onWipe([x]) {
    if (this.#sources.length < 2) return false;
    const place = this.viewport.place(this);
    return Math.abs(x - place.left - this.wipe * this.#sources[0].size[1] * place.scale) < GRIP * window.devicePixelRatio;
  }

  #listen() {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button > 0) return;
      canvas.setPointerCapture(event.pointerId);
      const spot = this.#spot(event);
      this.#pointers.set(event.pointerId, spot);
      this.gesture = this.#pointers.size > 1 ? "pinch" : this.#onWipe(spot) ? "wipe" : "click";
      this.begin = spot;
      this.on.grasp?.();
    });
    canvas.addEventListener("pointermove", (event) => {
      const spot = this.#spot(event), before = this.#pointers.get(event.pointerId);
      if (!before) {
        canvas.style.cursor = this.#onWipe(spot) ? "ew-resize" : "";
        const at = this.pixel(spot);
        this.on.point?.(at && at[0], at && at[1]);
        return;
      }
      if (this.gesture === "wipe") {
        const place = this.viewport.place(this), wide = this.#sources[0].size[1] * place.scale;
        this.on.wipe?.(Math.min(1, Math.max(0, (spot[0] - place.left) / wide)));
      } else if (this.gesture === "pinch") {
        this.#pinch(event.pointerId, spot);
      } else {
        const far = Math.hypot(spot[0] - this.begin[0], spot[1] - this.begin[1]);
        if (this.gesture === "click" && far > CLICK * window.devicePixelRatio) this.gesture = "move";
        const by = [spot[0] - before[0], spot[1] - before[1]];
        if (this.gesture === "move" && !this.on.drag?.(...by, event, this.pixel(this.begin), this.pixel(spot))) this.viewport.move(this, ...by);
      }
      this.#pointers.set(event.pointerId, spot);
    });
    const up = (event) => {
      if (!this.#pointers.delete(event.pointerId)) return;
      const at = this.pixel(this.#spot(event));
      if (event.type === "pointerup" && this.gesture === "click" && at) this.on.choose?.(...at);
      if (this.gesture !== "pinch" || !this.#pointers.size) this.gesture = null;
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("pointerleave", () => this.on.point?.(null, null));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 30 : 1;
      this.viewport.enlarge(this, ...this.#spot(event), Math.exp(-0.0022 * lines * event.deltaY));
    }, { passive: false });
    canvas.addEventListener("dblclick", () => this.viewport.fit());
  }

  #pinch(moved, spot) {
    const other = [...this.#pointers].find(([id]) => id !== moved)?.[1], before = this.#pointers.get(moved);
    if (!other) return;
    const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
    const middle = (a, b) => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
    const [from, to] = [middle(before, other), middle(spot, other)];
    this.viewport.move(this, to[0] - from[0], to[1] - from[1]);
    this.viewport.enlarge(this, ...to, apart(spot, other) / Math.max(1, apart(before, other)));
  }
}

/** Lines through a pixel of a picture, and a ring around it. */
export function drawCross(context, place, x, y) {
  const ratio = window.devicePixelRatio, { width, height } = context.canvas;
  const at = [place.left + (x + 0.5) * place.scale, place.top + (y + 0.5) * place.scale];
  const ring = Math.max(7 * ratio, place.scale * 0.75);
  context.save();
  context.beginPath();
  context.rect(place.left, place.top, place.width, place.height);
  context.clip();
  const lines = new Path2D(), circle = new Path2D();
  for (const [from, to] of [[0, at[0] - ring], [at[0] + ring, width]]) if (to > from) lines.moveTo(from, at[1]), lines.lineTo(to, at[1]);
  for (const [from, to] of [[0, at[1] - ring], [at[1] + ring, height]]) if (to > from) lines.moveTo(at[0], from), lines.lineTo(at[0], to);
  circle.arc(...at, ring, 0, 7);
  stroke(context, lines, ["rgb(0 0 0 / 45%)", 3], ["rgb(255 255 255 / 85%)", 1]);
  stroke(context, circle, ["rgb(0 0 0 / 60%)", 4], [mark(), 2]);
  context.restore();
}

/** A line between two pixels of a picture, and the box that they span. */
export function drawSpan(context, { left, top, scale }, from, to) {
  const line = new Path2D(), box = new Path2D(), at = (x, y) => [left + x * scale, top + y * scale];
  for (const [x, y] of [from, to]) line.lineTo(...at(x + 0.5, y + 0.5));
  box.rect(...at(...from.map((_, axis) => Math.min(from[axis], to[axis]))), ...from.map((_, axis) => (Math.abs(from[axis] - to[axis]) + 1) * scale));
  stroke(context, box, ["rgb(0 0 0 / 45%)", 3], ["rgb(255 255 255 / 85%)", 1]);
  stroke(context, line, ["rgb(0 0 0 / 60%)", 5], [mark(), 2.5]);
}

/** A dot on a pixel of a picture: where somebody points in another one. */
export function drawDot(context, place, x, y, radius = 4) {
  const ratio = window.devicePixelRatio;
  context.beginPath();
  context.arc(place.left + (x + 0.5) * place.scale, place.top + (y + 0.5) * place.scale, radius * ratio, 0, 7);
  Object.assign(context, { fillStyle: "#fff", strokeStyle: "#000", lineWidth: 1.5 * ratio });
  context.fill();
  context.stroke();
}

function drawNote(context, text) {
  const ratio = window.devicePixelRatio;
  Object.assign(context, { font: `${13 * ratio}px system-ui, sans-serif`, fillStyle: "rgb(0 0 0 / 62%)", textBaseline: "middle" });
  context.fillRect(8 * ratio, 8 * ratio, context.measureText(text).width + 16 * ratio, 24 * ratio);
  context.fillStyle = "#fff";
  context.fillText(text, 16 * ratio, 20 * ratio);
}

export const mark = () => getComputedStyle(document.documentElement).getPropertyValue("--mark").trim();
