// How the values of a map are distributed: a bar for each bin of its scale, in the colours of the scale.

import { ticks } from "./colourbar.js";
import { css } from "./colours.js";
import { mark } from "./picture.js";
import { array, newest } from "./server.js";

const BAR = 4; // pixels of the screen for a bin, about
const MARGIN = { left: 44, right: 12, top: 20, bottom: 20 };

export class Histogram {
  #found = null;
  #wanted = null;

  constructor(canvas, arrived) {
    this.canvas = canvas;
    this.ask = newest((wanted) => array("histogram", wanted.query), ({ data }, wanted) => {
      this.#found = { data, wanted };
      this.draw();
      arrived();
    });
    new ResizeObserver(() => this.#want()).observe(canvas);
  }

  /** Show a map: { key, query, title, scale: { colours, low, high }, value }; null for none. `value` is marked. */
  show(wanted) {
    this.#wanted = wanted;
    this.#want();
  }

  /** Whether its bars are those of the map that is shown, or nobody sees them. */
  get isComplete() {
    return !this.#wanted || !this.canvas.offsetParent || this.#found?.wanted.key === this.#wanted.key;
  }

  #want() {
    const { canvas } = this, wide = canvas.clientWidth - MARGIN.left - MARGIN.right, wanted = this.#wanted;
    if (wanted && wide > 40 && canvas.offsetParent) {
      const { low, high } = wanted.scale, bins = Math.min(256, Math.floor(wide / BAR)), key = `${wanted.key} ${low} ${high} ${bins}`;
      if (key !== this.asked) {
        this.asked = key;
        this.ask({ ...wanted, query: { ...wanted.query, low, high, bins } });
      }
    }
    this.draw();
  }

  draw() {
    if (this.drawing) return;
    this.drawing = requestAnimationFrame(() => {
      this.drawing = 0;
      this.#drawNow();
    });
  }

  #drawNow() {
    const { canvas } = this, context = canvas.getContext("2d"), ratio = window.devicePixelRatio;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    canvas.width = Math.max(1, Math.round(width * ratio));
    canvas.height = Math.max(1, Math.round(height * ratio));
    canvas.dataset.drawn = "";
    const wanted = this.#wanted, found = this.#found;
    if (!wanted || !found || found.wanted.key !== wanted.key || height < 60) return;
    const { colours, low, high } = wanted.scale, shares = found.data, styles = getComputedStyle(document.documentElement);
    const ink = (name) => styles.getPropertyValue(name).trim();
    const box = { left: MARGIN.left, right: width - MARGIN.right, top: MARGIN.top, bottom: height - MARGIN.bottom };
    const most = Math.max(...shares, 1e-6), at = (share) => box.left + share * (box.right - box.left);
    context.scale(ratio, ratio);
    context.font = "12px system-ui, sans-serif";
    context.fillStyle = ink("--muted");
    context.textBaseline = "middle";
    context.fillText(wanted.title, box.left, 8);
    context.textAlign = "right";
    context.fillText(`${Number(most.toPrecision(2))} %`, box.left - 6, box.top + 4);
    context.fillText("0 %", box.left - 6, box.bottom);
    shares.forEach((share, k) => {
      const [from, to] = [at(k / shares.length), at((k + 1) / shares.length)], high = (share / most) * (box.bottom - box.top);
      context.fillStyle = css(colours, (k + 0.5) / shares.length);
      context.fillRect(from, box.bottom - high, Math.max(1, to - from - 0.5), high);
    });
    context.strokeStyle = ink("--muted"); // colours that are as light or as dark as the page are seen, too
    context.lineWidth = 1;
    context.beginPath();
    shares.forEach((share, k) => {
      for (const end of [k, k + 1]) context.lineTo(at(end / shares.length), box.bottom - (share / most) * (box.bottom - box.top));
    });
    context.stroke();
    context.fillStyle = ink("--line");
    context.fillRect(box.left, box.bottom, box.right - box.left, 1);
    context.fillStyle = ink("--muted");
    context.textAlign = "center";
    for (const [value, text] of ticks(low, high, (box.right - box.left) / 80)) {
      context.fillRect(at((value - low) / (high - low)) - 0.5, box.bottom, 1, 4);
      context.fillText(text, at((value - low) / (high - low)), box.bottom + 12);
    }
    const place = (wanted.value - low) / (high - low);
    if (place >= 0 && place <= 1) { // the chosen pixel
      context.strokeStyle = mark();
      context.lineWidth = 2;
      context.beginPath();
      context.moveTo(at(place), box.top - 2);
      context.lineTo(at(place), box.bottom);
      context.stroke();
    }
    canvas.dataset.drawn = found.wanted.key;
  }
}
