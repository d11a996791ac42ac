// Lines or bars over a value, with marks and a range whose ends can be dragged, drawn by uPlot.

/* global uPlot */
import { mark } from "./picture.js";

const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const NEAR = 9; // pixels beside the end of a range where it can be taken
const LEGEND = 130; // pixels of height from which on there is one

export class Plot {
  #drawn = "";
  #plot = null;
  #wanted = null;

  /** @param box  the element that it fills;  @param ranged  called with (low, high) when ends of the range are dragged */
  constructor(box, ranged = null) {
    Object.assign(this, { box, ranged });
    new ResizeObserver(() => this.show(this.#wanted)).observe(box);
  }

  /** Whether it shows what was wanted last, or nobody sees it. */
  get isComplete() {
    return !this.#wanted || !this.box.offsetParent || this.#wanted.key === this.box.dataset.drawn;
  }

  /**
   * Show lines or bars; null for none.
   * @param wanted  { key, unit, isSigned, x: [], lines: [{ label, values, faint, fills }], marks: [{ at, dashed }], band: [from, to],
   *   range: [low, high] }; with `fills`, colours of bars, these are drawn
   */
  show(wanted) {
    this.#wanted = wanted;
    if (wanted && !wanted.lines.length) return; // they come soon: until then those of before are seen
    const { clientWidth: width, clientHeight: height } = this.box, drawn = JSON.stringify([wanted, width, height, ink("--ink")]);
    if (drawn === this.#drawn) return;
    this.#drawn = drawn;
    this.#plot?.destroy();
    this.#plot = null;
    this.box.dataset.drawn = "";
    if (!wanted || width < 80 || height < 50) return;
    const axis = { stroke: ink("--muted"), font: "12px system-ui, sans-serif", grid: { stroke: ink("--line"), width: 1 }, ticks: { stroke: ink("--line"), width: 1, size: 4 } };
    const hasLegend = height > LEGEND && !this.ranged, said = (digits) => (_, value) => (value === null ? "" : value.toPrecision(digits));
    const series = wanted.lines.map(({ label, faint, fills }) => ({
      label, stroke: ink(faint ? "--muted" : "--brand"), width: faint ? 1 : 2, points: { show: false }, value: said(3),
      ...(fills ? { paths: uPlot.paths.bars({ size: [1, 100], disp: { fill: { unit: 3, values: () => fills }, stroke: { unit: 3, values: () => fills.map(() => ink("--muted")) } } }) } : {}),
    }));
    this.#plot = new uPlot({
      width, height: height - (hasLegend ? 22 : 0), padding: [8, 8, 0, 0], legend: { show: hasLegend },
      scales: { x: { time: false }, y: { range: (_, low, high) => (wanted.isSigned ? uPlot.rangeNum(low ?? 0, high ?? 1, 0.1, true) : [0, high || 1]) } },
      cursor: { y: false, points: { size: 5 }, drag: { x: false }, x: !this.ranged },
      axes: [{ ...axis, size: 26 }, { ...axis, size: 44, values: (_, all) => all.map((one) => `${one}${wanted.unit === "%" ? " %" : ""}`) }],
      series: [{ label: wanted.unit, value: said(4) }, ...series],
      hooks: { draw: [(plot) => this.#mark(plot, wanted)] },
    }, [wanted.x, ...wanted.lines.map(({ values }) => values)], this.box);
    if (this.ranged) this.#listen(this.#plot, wanted.range);
    this.box.dataset.drawn = wanted.key;
  }

  #mark({ ctx, bbox, valToPos }, { marks = [], band, range }) {
    const ratio = devicePixelRatio, at = (value) => valToPos(value, "x", true), { top, height } = bbox;
    const upright = (value, style, dash, wide = 2) => {
      ctx.strokeStyle = style;
      ctx.lineWidth = wide * ratio;
      ctx.setLineDash(dash.map((length) => length * ratio));
      ctx.beginPath();
      ctx.moveTo(at(value), top);
      ctx.lineTo(at(value), top + height);
      ctx.stroke();
    };
    ctx.save();
    ctx.fillStyle = "rgb(232 35 122 / 16%)";
    if (band) ctx.fillRect(at(band[0]), top, at(band[1]) - at(band[0]), height);
    for (const { at: value, dashed } of marks) upright(value, dashed ? ink("--ink") : mark(), dashed ? [5, 4] : []);
    ctx.fillStyle = ink("--ink");
    for (const value of range ?? []) {
      upright(value, ink("--ink"), [], 1);
      ctx.fillRect(at(value) - 3 * ratio, top + height / 2 - 9 * ratio, 6 * ratio, 18 * ratio);
    }
    ctx.restore();
  }

  #listen(plot, range) {
    let taken = -1;
    const near = (event) => range.findIndex((value) => Math.abs(plot.valToPos(value, "x") - event.offsetX) < NEAR);
    plot.over.onpointerdown = (event) => {
      taken = near(event);
      if (taken >= 0) plot.over.setPointerCapture(event.pointerId);
    };
    plot.over.onpointermove = (event) => {
      plot.over.style.cursor = near(event) < 0 ? "" : "ew-resize";
      if (taken < 0 || !event.buttons) return;
      range[taken] = plot.posToVal(event.offsetX, "x");
      plot.redraw(false);
    };
    plot.over.onpointerup = () => {
      if (taken >= 0 && range[0] < range[1]) this.ranged(...range);
      taken = -1;
    };
  }
}
