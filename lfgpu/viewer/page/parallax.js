// The view of a camera anywhere between the views: the map says where each of its points is in the nearest views.

const NEAREST = 4; // views that are blended
const MOST_STEPS = 64; // places along a ray at which the map is looked up
const KEPT = 130; // views on the graphics device

const VERTICES = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1); }`;

// Of the points along the ray of a pixel, from near to far, it sees the first one that does not lie before the surface.
const PIXELS = `#version 300 es
precision highp float;
uniform sampler2D map, views[${NEAREST}];
uniform vec2 size, at, offsets[${NEAREST}], range;
uniform float weights[${NEAREST}], steps;
out vec4 colour;
float surface(vec2 p) { return texelFetch(map, ivec2(clamp(p, vec2(0), size - 1.0)), 0).r; }
vec4 seen(int k, sampler2D view, vec2 p) {
  float inside = all(lessThan(abs(p / size - 0.5), vec2(0.5))) ? 1.0 : 1e-4;
  return vec4(texture(view, p / size).rgb, 1) * weights[k] * inside;
}
void main() {
  vec2 x = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y);
  float near = range.y, far = range.y, step = (range.y - range.x) / steps;
  for (float k = 0.0; k <= steps; k++) {
    far = range.y - k * step;
    if (surface(x + far * at) >= far - 1e-4) break;
    near = far;
  }
  for (int k = 0; k < 6; k++) {
    float middle = 0.5 * (near + far);
    if (surface(x + middle * at) >= middle) far = middle; else near = middle;
  }
  vec4 sum = vec4(0);
  ${Array.from({ length: NEAREST }, (_, k) => `sum += seen(${k}, views[${k}], x + far * (at - offsets[${k}]));`).join("\n  ")}
  colour = vec4(sum.rgb / sum.a, 1);
}`;

export class Parallax {
  #gl = null;
  #program = null;
  #textures = new Map(); // of views by key, the least recently used first
  #map = {};

  /** Whether pictures can be drawn by the graphics device; starts it. */
  get isThere() {
    if (this.#gl === null) this.#start();
    return Boolean(this.#gl);
  }

  #start() {
    this.canvas = document.createElement("canvas");
    const gl = (this.#gl = this.canvas.getContext("webgl2", { preserveDrawingBuffer: true }) ?? false);
    if (!gl) return;
    const program = (this.#program = gl.createProgram());
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTICES], [gl.FRAGMENT_SHADER, PIXELS]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    gl.useProgram(program);
  }

  #texture(found, smooth, fill) {
    const gl = this.#gl;
    gl.bindTexture(gl.TEXTURE_2D, found);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, smooth ? gl.LINEAR : gl.NEAREST);
    fill(gl);
    return found;
  }

  #view({ key, picture }) {
    const found = this.#textures.get(key) ?? this.#texture(this.#gl.createTexture(), true, (gl) => gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture));
    this.#textures.delete(key);
    this.#textures.set(key, found);
    for (const [old, texture] of this.#textures) {
      if (this.#textures.size <= KEPT) break;
      this.#gl.deleteTexture(texture);
      this.#textures.delete(old);
    }
    return found;
  }

  #takeMap({ key, data, shape: [height, width], step }) {
    if (this.#map.key === key) return;
    let [low, high] = [Infinity, -Infinity];
    for (const value of data) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
    const whole = Float32Array.from(data, (value) => (Number.isFinite(value) ? value : low) / step);
    const texture = this.#texture(this.#map.texture ?? this.#gl.createTexture(), false, (gl) => gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, width, height, 0, gl.RED, gl.FLOAT, whole));
    this.#map = { key, texture, range: [low / step, high / step] };
  }

  /**
   * The picture of a camera, as a canvas.
   * @param at  [du, dv] of the camera from the reference, view steps
   * @param map  { key, data, shape, step }: disparities of every `step`-th pixel
   * @param views  [{ key, offset, picture }] of those that have come, in pixels of the map, the nearest ones first
   */
  draw(at, map, views) {
    const gl = this.#gl, [height, width] = map.shape;
    const weight = ({ offset }) => 1 / ((offset[0] - at[0]) ** 2 + (offset[1] - at[1]) ** 2 + 1e-4), least = views[NEAREST] ? weight(views[NEAREST]) : 0;
    const chosen = Array.from({ length: NEAREST }, (_, k) => views[k] ?? views[0]);
    this.#takeMap(map);
    Object.assign(this.canvas, { width, height });
    gl.viewport(0, 0, width, height);
    const { range } = this.#map, steps = Math.min(MOST_STEPS, Math.ceil(1 + (range[1] - range[0]) * Math.max(...at.map(Math.abs))));
    for (const [name, kind, value] of [
      ["size", "2fv", [width, height]], ["at", "2fv", at], ["range", "2fv", range], ["steps", "1fv", [steps]], ["map", "1iv", [0]],
      ["views", "1iv", chosen.map((_, k) => k + 1)], ["offsets", "2fv", chosen.flatMap(({ offset }) => offset)],
      ["weights", "1fv", chosen.map((view, k) => (k < views.length ? weight(view) - least : 0))],
    ]) gl[`uniform${kind}`](gl.getUniformLocation(this.#program, name), value);
    [this.#map.texture, ...chosen.map((view) => this.#view(view))].forEach((texture, k) => {
      gl.activeTexture(gl.TEXTURE0 + k);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    return this.canvas;
  }
}

const REST = 6000, LAP = 9000; // milliseconds without a touch of anything, and once round
const TRIED = 8, SLOW = 50; // pictures after which it ends by itself where each takes so many milliseconds

/** Let a camera sway a little while nobody does anything: `move([du, dv])` from where it stands, null at the end. */
export class Sway {
  #since = 0; // when it began; 0 while it rests
  #timer = 0;
  #drawn = 0;
  isSlow = false;

  constructor(isWanted, move) {
    Object.assign(this, { isWanted, move });
    for (const kind of ["pointermove", "pointerdown", "keydown", "wheel", "change"]) addEventListener(kind, () => this.rest(), true);
    this.rest();
  }

  rest() {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.start(), REST);
    if (!this.#since) return;
    this.#since = 0;
    this.move(null);
  }

  start() {
    if (this.#since || !this.isWanted()) return;
    this.#since = performance.now();
    this.#drawn = 0;
    this.#go();
  }

  #go() {
    if (!this.#since) return;
    const passed = performance.now() - this.#since;
    if (++this.#drawn === TRIED) this.isSlow = passed > TRIED * SLOW;
    if (!this.isWanted()) {
      this.rest();
      return;
    }
    const turn = (2 * Math.PI * passed) / LAP, far = Math.min(1, passed / 2000);
    this.move([far * Math.sin(turn), 0.5 * far * Math.sin(2 * turn)]);
    setTimeout(() => requestAnimationFrame(() => this.#go()), 25);
  }
}
