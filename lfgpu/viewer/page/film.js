// The frames of a film: one by one, by a slider, or played.

import { $, orTell } from "./elements.js";
import { act, newest } from "./server.js";

const PACE = 80; // milliseconds between two frames at least

export class Film {
  #wanted = null; // the number of the frame that was asked for last
  #timer = 0;

  /** @param now  () => the state of the server;  @param isComplete  () => whether all pictures of it are drawn */
  constructor(now, isComplete) {
    Object.assign(this, { now, isComplete });
    this.ask = newest((frame) => orTell(() => act("turn", { frame })), (isDone) => {
      if (isDone) return;
      this.#wanted = null;
      if (this.#timer) this.toggle();
    });
    $("previous").onclick = () => this.step(-1);
    $("following").onclick = () => this.step(1);
    $("play").onclick = () => this.toggle();
    $("film").oninput = () => this.#turn($("film").valueAsNumber);
  }

  get #frames() {
    return this.now()?.film ?? [];
  }

  /** Show where in the film the state is. */
  show() {
    const { frame } = this.now(), frames = this.#frames, at = frames.indexOf(frame);
    $("film-bar").hidden = !frames.length;
    $("film").max = Math.max(0, frames.length - 1);
    if (frame === this.#wanted) this.#wanted = null;
    if (this.#wanted === null) $("film").value = at;
    $("film-text").textContent = `Frame ${at + 1} of ${frames.length}`;
    if (!frames.length && this.#timer) this.toggle();
  }

  /** Go some frames on or back; after the last one comes the first one. */
  step(by) {
    const frames = this.#frames, at = frames.indexOf(this.#wanted ?? this.now()?.frame);
    if (frames.length) this.#turn((at + by + frames.length) % frames.length);
  }

  /** Play, or stop playing. */
  toggle() {
    if (this.#timer) clearInterval(this.#timer);
    const isPlaying = !this.#timer && this.#frames.length > 1;
    this.#timer = isPlaying ? setInterval(() => this.#wanted === null && this.isComplete() && this.step(1), PACE) : 0;
    $("play").textContent = isPlaying ? "Stop" : "Play";
  }

  #turn(at) {
    this.#wanted = this.#frames[at];
    $("film").value = at;
    this.ask(this.#wanted);
  }
}
