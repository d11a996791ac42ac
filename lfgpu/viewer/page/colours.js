// From numbers to colours: maps by a colour map, views by exposure and gamma.

const opaque = 0xff000000;
export const UNDEFINED = 158; // the grey of pixels where nothing is known

const tables = new Map();

/** Take the colour maps of the server: [r, g, b, r, g, b ...] of 256 steps each. */
export function learn(colours) {
  for (const [name, steps] of Object.entries(colours)) {
    const table = new Uint32Array(256);
    for (let k = 0; k < 256; k++) table[k] = opaque | (steps[3 * k + 2] << 16) | (steps[3 * k + 1] << 8) | steps[3 * k];
    tables.set(name, table);
  }
}

export function css(name, share) {
  const value = tables.get(name)[Math.round(255 * Math.min(1, Math.max(0, share)))];
  return `rgb(${value & 255} ${(value >> 8) & 255} ${(value >> 16) & 255})`;
}

/** A map [y, x] as a picture; what is not finite is grey. */
export function paintMap(data, [height, width], { colours, low, high }) {
  const picture = new ImageData(width, height), pixels = new Uint32Array(picture.data.buffer);
  const table = tables.get(colours), factor = 255 / Math.max(high - low, 1e-12);
  const grey = opaque | (UNDEFINED << 16) | (UNDEFINED << 8) | UNDEFINED;
  for (let k = 0; k < pixels.length; k++) {
    const value = data[k];
    if (!Number.isFinite(value)) {
      pixels[k] = grey;
      continue;
    }
    const place = (value - low) * factor + 0.5;
    pixels[k] = table[place < 0 ? 0 : place > 255 ? 255 : place | 0];
  }
  return picture;
}

/** A view [y, x, c] as a picture; brighter by 2 ** exposure, then to the power of 1 / gamma. */
export function paintView(data, [height, width, channels], { exposure, gamma }) {
  const picture = new ImageData(width, height), pixels = new Uint32Array(picture.data.buffer);
  const table = brightness(data.BYTES_PER_ELEMENT === 1 ? 255 : 65535, exposure, gamma);
  if (channels === 1) {
    for (let k = 0; k < pixels.length; k++) {
      const value = table[data[k]];
      pixels[k] = opaque | (value << 16) | (value << 8) | value;
    }
  } else {
    for (let k = 0, at = 0; k < pixels.length; k++, at += 3) {
      pixels[k] = opaque | (table[data[at + 2]] << 16) | (table[data[at + 1]] << 8) | table[data[at]];
    }
  }
  return picture;
}

/** A picture as a canvas, which can be drawn enlarged. */
export function asCanvas(picture) {
  const canvas = Object.assign(document.createElement("canvas"), { width: picture.width, height: picture.height });
  canvas.getContext("2d").putImageData(picture, 0, 0);
  return canvas;
}

let last = {};

function brightness(most, exposure, gamma) {
  if (last.most === most && last.exposure === exposure && last.gamma === gamma) return last.table;
  const table = new Uint8Array(most + 1), gain = 2 ** exposure;
  for (let k = 0; k <= most; k++) table[k] = 255 * Math.min(1, (k / most) * gain) ** (1 / gamma) + 0.5;
  last = { most, exposure, gamma, table };
  return table;
}
