// The frame in which viser shows the points in space.

import { $, element } from "./elements.js";

// Nothing of viser but what it draws, on the page: what its panels would offer is offered by the page. A frame of another
// scheme of colours than its page's would have a background of its own, and viser is pale until its light has come.
const BARE = `body :not(canvas):not(:has(canvas)) { display: none !important; } * { background: none !important; }
  :root { color-scheme: light dark !important; } canvas { opacity: 1 !important; }`;

export class Space {
  #send;
  #tab = null;
  #frame = null;
  #isJoined = false; // whether the frame draws
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
    this.#isJoined = $("space-note").hidden = false;
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
    const isSeen = !text && this.#isJoined;
    $("space-note").hidden = isSeen;
    $("space-frame").classList.toggle("empty", !isSeen);
  }

  startOver() {
    this.#send({ startOver: true });
  }

  /** The scene is there: show it. */
  ready() {
    this.#frame?.remove();
    this.#isJoined = false;
    const src = `space/${this.#tab}/?fixedDpr=${devicePixelRatio}`; // else some pictures of a film are finer than others
    this.#frame = element("iframe", { src, title: "Points in space" });
    this.#frame.onload = () => {
      this.#frame.contentDocument?.head.append(element("style", { textContent: BARE }));
      this.#frame.contentWindow.addEventListener("keydown", (event) => { // before viser, whose keys walk through the scene
        event.stopImmediatePropagation();
        this.pressed(event);
      }, true);
    };
    $("space-frame").append(this.#frame);
  }

  /** The frame draws from now on. */
  joined() {
    this.#isJoined = true;
    this.note(this.noted);
  }
}
