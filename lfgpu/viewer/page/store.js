// What this tab shows: plain values, and who wants to know of their changes.

export class Store {
  #listeners = [];

  constructor(values) {
    Object.assign(this, values);
  }

  /** Change some values; those who listen to one that differs are told, once. */
  set(values) {
    const changed = Object.keys(values).filter((name) => this[name] !== values[name]);
    Object.assign(this, values);
    if (!changed.length) return;
    for (const [names, listener] of this.#listeners) {
      if (names.some((name) => changed.includes(name))) listener();
    }
  }

  /** Call `listener` after changes of any of these values. */
  on(names, listener) {
    this.#listeners.push([names.split(" "), listener]);
  }
}
