// Which part of the pictures is seen: the same part for all pictures of one size.

const LARGEST = 80; // pixels of the screen for one of the picture

export class Viewport {
  zoom = 1; // 1: everything is seen
  cx = 0; // pixel of the picture in the middle of each canvas
  cy = 0;
  size = [1, 1];
  #listeners = new Set();

  onChange(listener) {
    this.#listeners.add(listener);
  }

  changed() {
    for (const listener of this.#listeners) listener();
  }

  fit(size = this.size) {
    this.size = size;
    this.zoom = 1;
    [this.cy, this.cx] = size.map((side) => side / 2);
    this.changed();
  }

  #fitting({ canvas }) {
    return Math.min(canvas.width / this.size[1], canvas.height / this.size[0]);
  }

  /** Pixels of the screen for one of the picture: a whole number once somebody has zoomed in. */
  #scale(picture) {
    const scale = this.#fitting(picture) * this.zoom;
    return this.zoom > 1.001 && scale >= 1 ? Math.round(scale) : scale;
  }

  /** Where a picture lies on its canvas, in pixels of the screen. */
  place(picture) {
    const scale = this.#scale(picture), [height, width] = this.size, { canvas } = picture;
    const along = (room, side, centre) => {
      const free = room - side * scale, least = 1e-6; // halves of pixels are rounded to one side, whatever the arithmetic did
      return Math.round((free >= 0 ? free / 2 : Math.min(0, Math.max(free, room / 2 - centre * scale))) + least);
    };
    return {
      scale, width: width * scale, height: height * scale,
      left: along(canvas.width, width, this.cx), top: along(canvas.height, height, this.cy),
    };
  }

  /** Enlarge by a factor; the pixel below (x, y) of the canvas stays there. */
  enlarge(picture, x, y, factor) {
    const before = this.place(picture), fitting = this.#fitting(picture);
    const at = [(x - before.left) / before.scale, (y - before.top) / before.scale];
    this.zoom = Math.min(Math.max(1, this.zoom * factor), Math.max(1, LARGEST / fitting));
    const scale = this.#scale(picture), { width, height } = picture.canvas;
    this.cx = at[0] - (x - width / 2) / scale;
    this.cy = at[1] - (y - height / 2) / scale;
    this.#keepInside(picture);
    this.changed();
  }

  move(picture, dx, dy) {
    const { scale } = this.place(picture);
    this.cx -= dx / scale;
    this.cy -= dy / scale;
    this.#keepInside(picture);
    this.changed();
  }

  #keepInside(picture) {
    const [height, width] = this.size, scale = this.#scale(picture), { canvas } = picture;
    const inside = (centre, side, room) => {
      const half = room / 2 / scale;
      return 2 * half >= side ? side / 2 : Math.min(Math.max(centre, half), side - half);
    };
    this.cx = inside(this.cx, width, canvas.width);
    this.cy = inside(this.cy, height, canvas.height);
  }
}
