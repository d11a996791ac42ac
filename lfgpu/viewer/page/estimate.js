// The form for estimates: only the parameters of the method that is chosen, and what was typed counts.

import { $, element, orTell, tell } from "./elements.js";
import { act } from "./server.js";

export class Estimate {
  #changes = {};

  /** @param changed  called when something of what is wished for has changed */
  constructor(presets, changed) {
    Object.assign(this, { presets, changed });
    $("preset").replaceChildren(...presets.map(({ name }) => element("option", { value: name, textContent: name })));
    $("preset").onchange = () => this.#show();
    $("find-range").onchange = () => this.changed(($("range-row").hidden = $("find-range").checked));
    $("from").onchange = $("to").onchange = changed;
    $("reset").onclick = () => {
      this.#changes = {};
      this.#show();
    };
    $("parameter-search").oninput = () => this.#search();
    $("stop").onclick = () => orTell(() => act("stop"));
    $("estimate").onsubmit = (event) => {
      event.preventDefault();
      this.#start();
    };
    this.#show();
  }

  #preset() {
    return this.presets.find(({ name }) => name === $("preset").value);
  }

  #show() {
    const { about, method, sections } = this.#preset();
    $("preset-about").textContent = `${method}: ${about}`;
    const known = new Set(sections.flatMap(({ name, parameters }) => parameters.map((one) => `${name}.${one.name}`)));
    this.#changes = Object.fromEntries(Object.entries(this.#changes).filter(([name]) => known.has(name)));
    $("parameter-list").replaceChildren(...sections.flatMap(({ name, parameters }) => [
      element("h4", { textContent: name.replaceAll("_", " ") }), ...parameters.map((one) => this.#row(name, one)),
    ]));
    this.#count();
    this.#search();
  }

  /** Show the parameters in whose names or sentences a word is. */
  #search() {
    const word = $("parameter-search").value.trim().toLowerCase();
    for (const row of $("parameter-list").children) row.hidden = !row.textContent.toLowerCase().includes(word) && Boolean(word);
  }

  #row(section, one) {
    const name = `${section}.${one.name}`, value = this.#changes[name] ?? String(one.value);
    const row = element("label"), about = `${one.about}${one.choices ? "" : ` (${one.low} to ${one.high})`}`;
    row.dataset.name = name;
    const field = one.choices
      ? element("select", {}, ...one.choices.map((choice) => element("option", { value: choice, textContent: choice })))
      : element("input", { type: "text", inputMode: "decimal" });
    field.value = value;
    row.classList.toggle("changed", name in this.#changes);
    field.oninput = () => {
      if (field.value.trim() === String(one.value)) delete this.#changes[name];
      else this.#changes[name] = field.value.trim();
      row.classList.toggle("changed", name in this.#changes);
      const value = Number(field.value), isNumber = field.value.trim() !== "" && Number.isFinite(value) && !(one.whole && value % 1);
      row.classList.toggle("wrong", !one.choices && !(isNumber && value >= (one.low ?? -Infinity) && value <= (one.high ?? Infinity)));
      this.#count();
    };
    row.append(element("span", { textContent: one.name.replaceAll("_", " ") }), field, element("small", { textContent: about }));
    return row;
  }

  #count() {
    this.changed();
    const changes = Object.entries(this.#changes);
    $("changed").textContent = changes.length ? `(${changes.length} changed)` : "";
    $("estimate-name").placeholder = [$("preset").value, ...changes.map(([name, value]) => `${name.split(".")[1]} ${value}`)].join(", ");
  }

  /** What is to be estimated. */
  get wish() {
    const range = $("find-range").checked ? null : [$("from").valueAsNumber, $("to").valueAsNumber];
    return { preset: $("preset").value, values: this.#changes, range };
  }

  #start() {
    orTell(() => act("estimate", { ...this.wish, name: $("estimate-name").value.trim() || $("estimate-name").placeholder }));
  }

  /** Show how far the estimate is, and offer what can be done. */
  progress({ text, share, busy, failed }, canEstimate) {
    $("estimate").hidden = !canEstimate;
    $("no-estimate").hidden = canEstimate;
    $("run").disabled = busy;
    $("stop").hidden = $("progress").hidden = !busy;
    $("progress").value = share;
    $("progress-text").textContent = text;
    $("progress-text").title = text;
    $("progress-text").classList.toggle("bad", failed);
    if (failed && text !== this.said) tell(text);
    this.said = text;
  }
}
