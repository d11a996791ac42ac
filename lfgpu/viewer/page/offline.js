// What server.js asks of the server, from what is in a page of its own.

export { newest, offer } from "./asking.js";

const { fixed, state, sight, views, thumbnails, maps, differences } = JSON.parse(document.getElementById("data").textContent);
const lf = state.lightField, [height, width] = state.size;

const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

async function unpacked({ data, shape }) {
  const stream = new Blob([bytes(data)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return { data: new Uint8Array(await new Response(stream).arrayBuffer()), shape };
}

const once = (make, known = new Map()) => (...words) => {
  const key = words.join("|");
  if (!known.has(key)) known.set(key, make(...words));
  return known.get(key);
};
const picture = once(async (index) => createImageBitmap(new Blob([bytes(views[index])], { type: "image/webp" })));
const map = once(async (name, kind) => new Float32Array((await unpacked(maps[name][kind])).data.buffer));

/** The numbers of a map, or of one minus another. */
async function numbers({ result, kind, minus }) {
  const values = await map(result, kind);
  if (!minus) return values;
  const other = await map(minus, kind);
  return values.map((value, k) => value - other[k]);
}

/** Pixels [y, x, 3] of a part of a view, which becomes `wide` x `high`. */
async function pixels(index, [x, y, w, h], wide, high) {
  const context = new OffscreenCanvas(wide, high).getContext("2d");
  context.drawImage(await picture(index), x, y, w, h, 0, 0, wide, high);
  return context.getImageData(0, 0, wide, high).data.filter((_, k) => k % 4 !== 3);
}

const ARRAYS = {
  async view({ index, level, column, row }) {
    const side = 512 * 2 ** level, [x, y] = [column * side, row * side], [w, h] = [Math.min(side, width - x), Math.min(side, height - y)];
    const [wide, high] = [w, h].map((length) => Math.ceil(length / 2 ** level));
    return { data: await pixels(index, [x, y, w, h], wide, high), shape: [high, wide, 3] };
  },
  async map({ level, column, row, ...query }) {
    const values = await numbers(query), step = 2 ** level, side = 512 * step, [x, y] = [column * side, row * side];
    const [wide, high] = [Math.min(side, width - x), Math.min(side, height - y)].map((length) => Math.ceil(length / step));
    return { data: Float32Array.from({ length: wide * high }, (_, k) => values[(y + Math.floor(k / wide) * step) * width + x + (k % wide) * step]), shape: [high, wide] };
  },
  async histogram({ low, high, bins, ...query }) {
    const data = new Float32Array(bins), known = (await numbers(query)).filter(Number.isFinite);
    for (const value of known) if (value >= low && value <= high) data[Math.min(bins - 1, Math.floor(((value - low) / (high - low)) * bins))] += 100 / known.length;
    return { data, shape: [bins] };
  },
  async epi({ along, at }) {
    const [list, length] = along === "row" ? [lf.row, width] : [lf.column, height];
    const lines = await Promise.all(list.map((n) => (along === "row" ? pixels(n, [0, at, width, 1], width, 1) : pixels(n, [at, 0, 1, height], 1, height))));
    return { data: Uint8Array.from(lines.flatMap((line) => [...line])), shape: [list.length, length, 3] };
  },
  thumbnails: () => unpacked(thumbnails),
};

export const array = (what, query) => (ARRAYS[what] ?? act)(query);

/** The pixel of the reference that a camera shows at a place: of those that are seen there, the nearest surface. */
async function inReference({ x, y, du, dv, result }) {
  if (!du && !dv) return [x, y];
  if (!maps[result]) return null;
  const values = await map(result, "disparity");
  let best = null;
  values.forEach((d, k) => {
    const near = Math.max(Math.abs((k % width) - d * du - x), Math.abs(Math.floor(k / width) - d * dv - y)) <= 0.75;
    if (near && !(d <= values[best])) best = k;
  });
  return best === null ? null : [best % width, Math.floor(best / width)];
}

async function at(query) {
  const pixel = await inReference(query), found = { pixel, values: {}, other: {} };
  for (const [name, into] of [[query.result, "values"], [query.other, "other"]]) {
    for (const kind of pixel && maps[name] ? Object.keys(maps[name]) : []) {
      const value = (await map(name, kind))[pixel[1] * width + pixel[0]];
      found[into][kind] = Number.isFinite(value) ? value : null;
    }
  }
  return found;
}

const VALUES = { at, fixed: () => fixed, difference: ({ kind, result, minus }) => differences[`${kind}|${result}|${minus}`] ?? act() };
export const values = async (what, query) => (VALUES[what] ?? act)(query);

export async function act() {
  throw new Error("This page has no server: that can be had with lfgpu view only.");
}
export const download = act;

export function connect(heard) {
  if (!location.hash) history.replaceState(null, "", `#${sight}`);
  setTimeout(() => heard({ state }));
  return () => {};
}
