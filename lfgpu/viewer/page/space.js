// The frame in which viser shows the points in space.

import { $, element } from "./elements.js";

// Nothing of viser but what it draws: what its panels would offer is offered by the page.
const BARE = "body :not(canvas):not(:has(canvas)) { display: none !important; }";

export class Space {
  #send;
  #tab = null;
  #frame = null;
  #asked = "";
  #timer = 0;

  /** @param send  what sends words to the server;  @param scene  () => what is wanted, null for nothing;
   *  @param pressed  called with each key that is pressed in the frame */
  constructor(send, scene, pressed) {
    this.#send = send;
    Object.assign(this, { scene, pressed });
  }

  /** The server knows this tab by a new name: what it had in space is gone. */
  belong(tab) {
    this.#tab = tab;
    this.#asked = "";
    this.#frame?.remove();
    this.#frame = null;
    $("space-note").hidden = false;
    this.refresh();
  }

  get tab() {
    return this.#tab;
  }

  /** Tell the server what is wanted now, not more often than it can be drawn. */
  refresh() {
    if (this.#timer) return;
    this.#timer = setTimeout(() => {
      this.#timer = 0;
      const scene = this.scene(), wish = JSON.stringify(scene);
      if (!scene || !this.#tab || wish === this.#asked) return;
      this.#asked = wish;
      this.#send({ scene });
    }, 50);
  }

  /** Say something in place of the scene, or nothing. */
  note(text) {
    this.noted = text;
    $("space-note").textContent = text || "Starting 3D …";
    $("space-note").hidden = !text && Boolean(this.#frame?.dataset.drawn);
    $("space-frame").classList.toggle("empty", Boolean(text));
  }

  startOver() {
    this.#send({ startOver: true });
  }

  /** The scene is there: show it. */
  ready() {
    this.#frame?.remove();
    const dark = matchMedia("(prefers-color-scheme: dark)").matches ? "?darkMode" : "";
    this.#frame = element("iframe", { src: `space/${this.#tab}/${dark}`, title: "Points in space" });
    this.#frame.onload = () => {
      this.#frame.contentDocument?.head.append(element("style", { textContent: BARE }));
      this.#frame.contentWindow.addEventListener("keydown", (event) => { // before viser, whose keys walk through the scene
        event.stopImmediatePropagation();
        this.pressed(event);
      }, true);
      this.#frame.dataset.drawn = "true";
      this.note(this.noted);
    };
    $("space-frame").append(this.#frame);
  }
}
