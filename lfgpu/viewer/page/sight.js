// What this tab shows, as a word in its address: a link opens the same sight again, and changes can be taken back.

const KEPT = ("view camera pixel tested quantity result stage other third fourth compare flipped colourMaps ranges exposure "
  + "gamma left right focus aperture plot alone widths mesh paint metric least size background cameras").split(" ");
const CALM = 400; // milliseconds without a change, which make one step of what is taken back
const MOST = 200; // steps that are kept

export class Sight {
  #past = [];
  #now = "";
  #timer = 0;

  /** @param isFixed  () => whether what is shown should be kept now;  @param apply  takes values of a sight */
  constructor(ui, viewport, isFixed, apply) {
    Object.assign(this, { ui, viewport, isFixed, apply });
    const later = () => {
      clearTimeout(this.#timer);
      this.#timer = setTimeout(() => this.#keep(), CALM);
    };
    ui.on(KEPT.join(" "), later);
    viewport.onChange(later);
    addEventListener("hashchange", () => this.open(location.hash.slice(1)));
    later();
  }

  get #text() {
    const { zoom, cx, cy } = this.viewport, values = Object.fromEntries(KEPT.map((name) => [name, this.ui[name]]));
    return JSON.stringify({ ...values, place: zoom > 1 ? [zoom, cx, cy] : null });
  }

  #keep() {
    const text = this.#text;
    if (!this.isFixed() || text === this.#now) return;
    if (this.#now) this.#past.push(this.#now);
    this.#past.splice(0, this.#past.length - MOST);
    this.#now = text;
    history.replaceState(null, "", `#${encodeURIComponent(text)}`);
  }

  /** Show the sight of an address; nothing happens if it is none. */
  open(hash) {
    try {
      const { place, ...values } = JSON.parse(decodeURIComponent(hash));
      this.apply(Object.fromEntries(KEPT.filter((name) => name in values).map((name) => [name, values[name]])));
      if (place) Object.assign(this.viewport, { zoom: place[0], cx: place[1], cy: place[2] });
      else this.viewport.fit();
      this.viewport.changed();
    } catch { /* a word of something else */ }
  }

  undo() {
    this.#keep(); // what has just changed
    const before = this.#past.pop();
    if (!before) return;
    this.#now = before;
    this.open(encodeURIComponent(before));
  }
}
