// Pieces of pictures: asked for when they are looked at, kept while there is room.

import { tell } from "./elements.js";
import { array } from "./server.js";

const SIDE = 512; // pixels of a tile, as the server has them
const QUICK = 360; // pixels of the longer side of what is computed first: one tile
const COMPUTED = 256; // pixels of a finer tile that is computed
const ROOM = 256 * 2 ** 20; // bytes that are kept
const AT_ONCE = 5;

// A source of tiles: { key, size: [height, width], what, query, paint(data, shape), look, isComputed, isMap }.
// `look` changes with what `paint` draws. What `isComputed` by the server takes long: its tiles are smaller.

const known = new Map(); // tiles by key, the least recently used first
let waiting = []; // { key, source, level, column, row, asker }
let busy = 0, bytes = 0;
const under = new Set();
const listeners = new Set();

export const onArrival = (listener) => listeners.add(listener);

/** The level of a source at which it is one tile. */
export function coarsest({ size, isComputed }) {
  return Math.max(0, Math.ceil(Math.log2(Math.max(...size) / (isComputed ? QUICK : SIDE))));
}

/** Pixels of a tile of a source at a level. */
export const sideAt = (source, level) => (source.isComputed && level < coarsest(source) ? COMPUTED : SIDE);

export const keyOf = (source, level, column, row) => `${source.key}|${level}|${column}|${row}`;

/** A tile as a canvas in its present look; null if it has not come yet. */
export function tile(source, level, column, row) {
  const key = keyOf(source, level, column, row), found = known.get(key);
  if (!found?.data) return null;
  known.delete(key);
  known.set(key, found);
  if (found.look !== source.look) {
    const [height, width] = found.shape;
    found.canvas ??= Object.assign(document.createElement("canvas"), { width, height });
    found.canvas.getContext("2d").putImageData(source.paint(found.data, found.shape), 0, 0);
    found.look = source.look;
  }
  return found.canvas;
}

/** The numbers of a tile, { data, shape }; null if it has not come yet. */
export function numbers(source, level, column, row) {
  const found = known.get(keyOf(source, level, column, row));
  return found?.data ? found : null;
}

/** Tell which tiles somebody wants now, the most urgent first; what it wanted before and has not begun is dropped. */
export function want(asker, wishes) {
  waiting = waiting.filter((wish) => wish.asker !== asker);
  for (const [source, level, column, row] of wishes) {
    const key = keyOf(source, level, column, row);
    if (!known.has(key) && !under.has(key)) waiting.push({ key, source, level, column, row, asker });
  }
  work();
}

function ask(source, level, column, row) {
  const query = { ...source.query, level, column, row };
  if (source.isComputed) query.side = sideAt(source, level);
  return array(source.what, query);
}

/** All tiles of a source, each pixel a square of some, for saving. */
export async function wholePicture(source, times = 1) {
  const [height, width] = source.size;
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  const context = canvas.getContext("2d");
  const side = sideAt(source, 0);
  for (let row = 0; row * side < height; row++) {
    for (let column = 0; column * side < width; column++) {
      const { data, shape } = await ask(source, 0, column, row);
      context.putImageData(source.paint(data, shape), column * side, row * side);
    }
  }
  if (times === 1) return canvas;
  const large = Object.assign(document.createElement("canvas"), { width: times * width, height: times * height }), onto = large.getContext("2d");
  onto.imageSmoothingEnabled = false;
  onto.drawImage(canvas, 0, 0, large.width, large.height);
  return large;
}

function work() {
  while (busy < AT_ONCE && waiting.length) {
    const { key, source, level, column, row } = waiting.shift();
    if (known.has(key) || under.has(key)) continue;
    busy++;
    under.add(key);
    ask(source, level, column, row)
      .then((found) => keep(key, found), (error) => fail(key, source, error))
      .finally(() => {
        busy--;
        under.delete(key);
        work();
        for (const listener of listeners) listener();
      });
  }
}

/** One that fails is not asked for again, unless the state that it was asked of is forgotten: then with the next one. */
function fail(key, source, error) {
  if (error.isGone) return;
  known.set(key, {});
  if (source.isComputed) tell(error.message);
}

function keep(key, { data, shape }) {
  known.set(key, { data, shape });
  bytes += weight(data, shape);
  for (const [old, found] of known) {
    if (bytes <= ROOM) break;
    if (found.data) bytes -= weight(found.data, found.shape);
    known.delete(old);
  }
}

const weight = (data, shape) => data.byteLength + 4 * shape[0] * shape[1];
