// Opening and saving.

import { $, element, orTell } from "./elements.js";
import { act, download, offer } from "./server.js";
import { wholePicture } from "./tiles.js";

/** @param now  () => what can be saved: { state, ui, mapSource, viewSource, scale, tab } */
export function setUpFiles(formats, now) {
  for (const dialog of document.querySelectorAll("dialog")) {
    dialog.addEventListener("click", (event) => event.target === dialog && dialog.close()); // beside it
  }
  $("open-files").onclick = () => $("files").showModal();
  $("open-form").onsubmit = (event) => {
    event.preventDefault();
    $("files").close();
    orTell(() => act("open", { path: $("path").value }));
  };
  $("save-files").onclick = () => openSaving(now());
  $("formats").replaceChildren(...formats.map(({ suffix, about }) => {
    const button = element("button", { textContent: suffix, type: "button" });
    button.onclick = () => save(now(), "result", { suffix });
    return element("div", {}, button, element("span", { textContent: about, className: "muted" }));
  }));
  $("save-figure").onclick = () => {
    const { ui, scale } = now();
    save(now(), "figure", { kind: ui.quantity, colours: scale.colours, low: scale.low, high: scale.high });
  };
  $("save-map").onclick = () => savePicture(now().mapSource, `${name()}-${now().ui.quantity}`);
  $("save-view").onclick = () => savePicture(now().viewSource, `${name()}-view`);
  $("save-page").onclick = () => save(now(), "page", { sight: location.hash.slice(1) });
  for (const button of $("save-space").children) button.onclick = () => save(now(), "space", { tab: now().tab, form: button.value });
}

function openSaving({ state, ui }) {
  const chosen = state.results.some((one) => one.name === ui.result);
  $("save-what").textContent = chosen ? ui.result + (ui.stage === "final" ? "" : `, after ${ui.stage}`) : "none yet";
  for (const button of [...$("formats").querySelectorAll("button"), $("save-map"), $("save-figure")]) button.disabled = !chosen;
  $("save-view").disabled = !state.lightField;
  for (const button of $("save-space").children) button.disabled = ui.right !== "space";
  $("save-space").title = ui.right === "space" ? "As the frame shows it, without marks" : "Open the tab 3D first";
  const of = state.lightField?.name ?? "", result = chosen ? ui.result : "";
  const plain = result.startsWith(of) ? result || of : [of, result].filter(Boolean).join("-");
  $("save-name").value = plain.replace(/[^\p{L}\p{N}.+-]+/gu, "_") || "lfgpu";
  $("saving").showModal();
}

const name = () => $("save-name").value.trim() || "lfgpu";

function save({ ui, state }, what, query) {
  const suffix = what === "result" || what === "page" ? "" : `-${what === "figure" ? ui.quantity : "3d"}`;
  orTell(() => download(what, { result: ui.result, stage: ui.stage, of: state.revision, name: name() + suffix, ...query }));
}

async function savePicture(source, as) {
  await orTell(async () => {
    const canvas = await wholePicture(source, Number($("save-times").value));
    offer(await new Promise((done) => canvas.toBlob(done, "image/png")), `${as}.png`);
  });
}
