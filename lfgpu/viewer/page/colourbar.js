// The scale of a map: its colours with numbers; a pointed end means that values lie beyond it.

import { css } from "./colours.js";
import { fitted } from "./elements.js";

export function drawScale(canvas, { colours, low, high, extent }) {
  const ratio = fitted(canvas);
  const context = canvas.getContext("2d"), styles = getComputedStyle(document.documentElement);
  context.scale(ratio, ratio);
  const wide = 18, left = 4, tip = 13, height = canvas.clientHeight, top = 16, bottom = height - 16;
  if (bottom - top < 20 || !(high > low)) return;
  for (let y = top; y < bottom; y++) {
    context.fillStyle = css(colours, (bottom - y - 0.5) / (bottom - top));
    context.fillRect(left, y, wide, 1.5);
  }
  const span = high - low, slack = 1e-6 * span;
  const point = (y, up, share) => {
    context.fillStyle = css(colours, share);
    context.beginPath();
    context.moveTo(left, y);
    context.lineTo(left + wide / 2, y + up * tip);
    context.lineTo(left + wide, y);
    context.fill();
  };
  const beyond = [extent && extent[0] < low - slack, extent && extent[1] > high + slack];
  if (beyond[1]) point(top + 0.5, -1, 1);
  if (beyond[0]) point(bottom - 0.5, 1, 0);
  canvas.dataset.beyond = `${Boolean(beyond[0])} ${Boolean(beyond[1])}`;
  context.fillStyle = context.strokeStyle = styles.getPropertyValue("--ink").trim();
  context.font = "12px system-ui, sans-serif";
  context.textBaseline = "middle";
  for (const [value, text] of ticks(low, high, (bottom - top) / 56)) {
    const y = bottom - ((value - low) / span) * (bottom - top);
    context.fillRect(left + wide, y - 0.5, 4, 1);
    context.fillText(text, left + wide + 8, y);
  }
}

/** Round numbers between two ends as [value, text], not more than about `most`. */
export function ticks(low, high, most) {
  const least = (high - low) / Math.max(2, most), power = 10 ** Math.floor(Math.log10(least));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= least * 0.999);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-6 * (high - low); k++) {
    found.push([k * step, (k * step).toFixed(Math.min(digits, 8)).replace("-", "−")]);
  }
  return found;
}
