// The page of the viewer: what is shown follows from the state of the server and from what was chosen in this tab.

import { drawScale } from "./colourbar.js";
import { asCanvas, css, learn, paintMap, paintView } from "./colours.js";
import { $, element, fill, number, orTell, stroke, tell } from "./elements.js";
import { Epi } from "./epi.js";
import { Estimate } from "./estimate.js";
import { setUpFiles } from "./files.js";
import { Film } from "./film.js";
import { Picture, drawCross, drawDot, drawSpan } from "./picture.js";
import { act, array, connect, newest, values } from "./server.js";
import { Sight } from "./sight.js";
import { Space } from "./space.js";
import { Store } from "./store.js";
import { Thumbnails, neighbour } from "./thumbnails.js";
import { Plot } from "./plots.js";
import { Parallax, Sway } from "./parallax.js";
import { coarsest, numbers, onArrival, tile, want } from "./tiles.js";
import { Viewport } from "./viewport.js";

const COLOURS = { RdBu_r: "blue, white, red", viridis_r: "viridis, reversed", gray: "grey" }; // names for people
const NOTHING = "", FINAL = "final", PICTURE = "picture";
const phone = matchMedia("(max-width: 760px)"), dark = matchMedia("(prefers-color-scheme: dark)");

const fixed = await values("fixed");
learn(fixed.colours);

let state = null; // of the server
const ui = new Store({
  view: 0, camera: null, // [du, dv] of one between the views
  sway: null, pixel: null, found: null, hover: null, // found: the values at the pixel
  tested: null, costs: null, // a disparity that is tried at the pixel, and what all of them cost there
  from: null, span: null, // where a line to the pixel begins, and what was measured along it
  preview: false, previewed: null, // whether there is one, and { data, shape, left, top }
  quantity: "disparity", result: NOTHING, stage: FINAL, other: NOTHING, third: NOTHING, fourth: NOTHING, compare: "wipe", flipped: false,
  difference: null, plot: "values", alone: null, widths: {}, // of the settings, pixels, and of the views, shares
  colourMaps: {}, ranges: {}, // of each quantity, where they were changed
  exposure: 0, gamma: 1, left: "view", right: "map", focus: 0, aperture: 0,
  mesh: false, paint: PICTURE, metric: true, least: 0.5, size: 1.3, background: "page", cameras: false, orbit: false,
});

// --- what is shown ---

const lf = () => state?.lightField ?? null;
const entry = (name) => state?.results.find((one) => one.name === name) ?? null;
const look = () => ({ exposure: ui.exposure, gamma: ui.gamma });

const OTHERS = ["other", "third", "fourth"];
const isMinus = () => ui.compare === "minus" && Boolean(mapSource(ui.other));
const kindShown = () => (isMinus() ? "difference" : ui.quantity);

function scale(kind = kindShown()) {
  if (kind === "difference") {
    const [low, high] = ui.ranges.difference ?? ui.difference?.limits ?? [-0.07, 0.07];
    return { colours: ui.colourMaps.difference ?? fixed.quantities.error.colours, low, high, extent: ui.difference?.extent };
  }
  const known = state?.scales[kind], [low, high] = ui.ranges[kind] ?? known?.limits ?? [0, 1];
  return { colours: ui.colourMaps[kind] ?? fixed.quantities[kind].colours, low, high, extent: known?.extent };
}

/** A map, or the map `minus` another one, which is the final one of its result. */
function mapSource(name, kind = ui.quantity, stage = FINAL, minus = NOTHING) {
  const one = entry(name), other = minus && mapSource(minus, kind);
  if (!one?.kinds.includes(kind) || (minus && !other)) return null;
  const shades = scale(minus ? "difference" : kind), key = `map ${one.identity} ${kind} ${stage}${kind === "error" ? ` ${state.views}` : ""}`;
  return {
    key: other ? `${key} minus ${other.key}` : key, size: state.size, what: "map", isMap: true,
    query: { result: name, kind, stage, of: state.revision, ...(minus ? { minus } : {}) }, look: `${shades.colours} ${shades.low} ${shades.high}`,
    paint: (data, shape) => paintMap(data, shape, shades),
  };
}

const shownSource = () => mapSource(ui.result, ui.quantity, ui.stage, isMinus() ? ui.other : NOTHING);

function viewSource(index = ui.view) {
  if (!lf()) return null;
  const { exposure, gamma } = look();
  const common = { size: state.size, look: `${exposure} ${gamma}`, paint: (data, shape) => paintView(data, shape, { exposure, gamma }) };
  const one = entry(ui.result);
  if (ui.left === "refocused") {
    const query = { disparity: ui.focus, aperture: ui.aperture, of: state.revision };
    return { ...common, key: `refocused ${state.views} ${ui.focus} ${ui.aperture}`, what: "refocused", query, isComputed: true };
  }
  if (ui.left === "sharp") {
    if (!one) return null;
    const query = { result: ui.result, stage: ui.stage, of: state.revision };
    return { ...common, key: `sharp ${state.views} ${one.identity} ${ui.stage}`, what: "sharp", query, isComputed: true };
  }
  if (ui.camera && index === ui.view) return cameraSource(common);
  return { ...common, key: `view ${state.views} ${index}`, what: "view", query: { index, of: state.revision } };
}

// --- a camera between the views ---

const parallax = new Parallax();
const VIEWS_AHEAD = 120, SWAY = 0.35; // of the aperture
const calm = matchMedia("(prefers-reduced-motion: reduce)"), canSway = () => !calm.matches && canInterpolate() && !sway.isSlow;
const canInterpolate = () => Boolean(lf() && entry(ui.result) && parallax.isThere);

function cameraSource(common) {
  const disparities = mapSource(ui.result, "disparity", ui.stage), level = coarsest(disparities);
  const views = lf().offsets.map((offset, n) => ({ offset, source: { ...common, key: `view ${state.views} ${n}`, what: "view", query: { index: n, of: state.revision } } }));
  const far = ({ offset }) => Math.hypot(offset[0] - ui.camera[0], offset[1] - ui.camera[1]);
  views.sort((a, b) => far(a) - far(b));
  const draw = () => {
    want(parallax, [disparities, ...views.slice(0, VIEWS_AHEAD).map(({ source }) => source)].map((source) => [source, level, 0, 0]));
    const found = numbers(disparities, level, 0, 0);
    const there = views.slice(0, VIEWS_AHEAD).map(({ offset, source }) => ({ offset, key: `${source.key} ${source.look}`, picture: tile(source, level, 0, 0) })).filter(({ picture }) => picture);
    if (!found || !there.length) return null;
    return parallax.draw(ui.camera, { key: disparities.key, ...found, step: 2 ** level }, there);
  };
  return { ...common, key: `camera ${state.views} ${disparities.key} ${ui.camera}`, draw };
}

/** Move the camera to [du, dv] from the reference, not beyond the outermost views; without a map, to the nearest view. */
function moveCamera(wanted) {
  const { offsets } = lf(), inside = (value, axis) => Math.min(Math.max(value, Math.min(...offsets.map((one) => one[axis]))), Math.max(...offsets.map((one) => one[axis])));
  const camera = wanted.map(inside), far = offsets.map(([du, dv]) => Math.hypot(du - camera[0], dv - camera[1]));
  ui.set({ camera: canInterpolate() ? camera : null, view: far.indexOf(Math.min(...far)), left: "view" });
  return camera;
}

const chooseView = (index) => ui.set({ view: index, camera: null, left: "view" });

let home = null; // where the camera is when it does not sway
const sway = new Sway(
  () => canInterpolate() && (ui.sway ?? canSway()) && ui.left === "view" && viewport.zoom === 1 && !document.hidden && !state.frame,
  (by) => {
    home ??= { camera: ui.camera, view: ui.view, at: cameraPlace() };
    if (by) moveCamera(home.at.map((at, axis) => at + by[axis] * SWAY * lf().aperture));
    else {
      ui.set({ camera: home.camera, view: home.view });
      home = null;
    }
  },
);

/** Where the camera of the view stands, [du, dv] from the reference. */
const cameraPlace = () => ui.camera ?? lf().offsets[ui.view];

/** Where the pixel is in the view; null where that is not known. */
function pixelInView() {
  if (!ui.pixel || !lf()) return ui.pixel;
  const [du, dv] = cameraPlace();
  if (!du && !dv) return ui.pixel;
  const disparity = ui.found?.values.disparity;
  return Number.isFinite(disparity) ? [ui.pixel[0] - disparity * du, ui.pixel[1] - disparity * dv] : null;
}

// --- pictures ---

const viewport = new Viewport();
let dragged = null; // where the camera is while it is dragged
const isOfReference = () => ui.left !== "view";

const view = new Picture($("view"), viewport, {
  point: (x, y) => point("left", x, y),
  choose: (x, y) => choose(x, y, offsetOf("left")).then((found) => {
    const disparity = found?.values.disparity;
    if (ui.left === "refocused" && Number.isFinite(disparity)) ui.set({ focus: disparity });
  }),
  overlay: (context, place) => {
    const at = isOfReference() ? ui.pixel : pixelInView(), over = ui.hover?.pane === "right" && ui.hover.pixel;
    if (spanned() && !offsetOf("left").some(Boolean)) drawSpan(context, place, ...spanned());
    if (at) drawCross(context, place, ...at);
    const [du, dv] = offsetOf("left"), disparity = ui.hover?.values?.disparity ?? NaN;
    if (over && (Number.isFinite(disparity) || !(du || dv))) drawDot(context, place, over[0] - (du && disparity * du), over[1] - (dv && disparity * dv));
  },
  drag: (dx, dy, { shiftKey }) => {
    if (isOfReference() || (viewport.zoom > 1.001) !== shiftKey) return false;
    const { width, height } = viewport.place(view), reach = 2 * lf().aperture;
    dragged = moveCamera([dragged[0] - (dx / width) * reach, dragged[1] - (dy / height) * reach]);
    return true;
  },
  grasp: () => (dragged = cameraPlace()),
  complete: () => takeLater(),
  next: () => state.frame ? [] : Object.values(ARROWS).map((arrow) => neighbour(lf(), ui.view, ...arrow)).filter((index) => index !== ui.view).map(viewSource),
});
const onMap = {
  point: (x, y) => point("right", x, y),
  drag: (dx, dy, { shiftKey }, from, to) => {
    if (shiftKey && from && to) measure(from, to);
    return shiftKey;
  },
  choose: (x, y) => choose(x, y, [0, 0]),
  wipe: (share) => {
    map.wipe = share;
    map.draw();
  },
  overlay: (context, place) => {
    if (ui.previewed && kindShown() === "disparity") drawPreview(context, place, ui.previewed);
    if (spanned()) drawSpan(context, place, ...spanned());
    if (ui.pixel) drawCross(context, place, ...ui.pixel);
    if (ui.hover?.pixel && (ui.hover.pane === "left" || mapsBeside().length > 1)) drawDot(context, place, ...ui.hover.pixel);
  },
  complete: () => takeLater(),
};
const map = new Picture($("map"), viewport, onMap), otherMaps = OTHERS.map((name) => new Picture($(`${name}-map`), viewport, onMap));
const pictures = [view, map, ...otherMaps];
onArrival(() => pictures.forEach((one) => one.draw()));

const epiState = () => ({ lf: lf(), pixel: ui.pixel, disparity: ui.found?.values.disparity, tested: ui.tested, hidden: ui.plot === "costs" && ui.costs ? ui.costs.hidden : [], look: look(), current: ui.left === "view" && !ui.camera ? ui.view : -1 });
const epis = [
  new Epi($("epi-row"), "row", view, epiState, (index, x) => choose(x, ui.pixel[1], lf().offsets[index], 1), testDisparity),
  new Epi($("epi-column"), "column", view, epiState, (index, y) => choose(ui.pixel[0], y, lf().offsets[index], 0), testDisparity),
];
const plot = new Plot($("plot"));
const histogram = new Plot($("histogram"), (low, high) => ui.set({ ranges: { ...ui.ranges, [kindShown()]: [low, high] } }));
const askBars = newest((query) => array("histogram", query), ({ data }, { key }) => {
  bars = { data: [...data], key };
  showHistogram();
  takeLater();
});
let bars = null; // shares of the pixels, per cent
const film = new Film(() => state, () => pictures.every((one) => one.isComplete));
const thumbnails = new Thumbnails($("thumbnails"), () => ({ lf: lf(), current: ui.view, look: look() }), chooseView);

/** Where the camera of what a pane shows stands. */
const offsetOf = (pane) => (pane === "left" && !isOfReference() ? cameraPlace() : [0, 0]);
const here = (x, y, [du, dv]) => ({ x, y, du, dv, result: ui.result, stage: ui.stage, other: ui.other, of: state.revision });

let choices = 0;

/** Choose the point that a pixel of a view shows; `keep` is the coordinate that stays as it is (an EPI has only one). */
async function choose(x, y, offset, keep = -1) {
  const choice = ++choices;
  return orTell(async () => {
    const found = await values("at", here(x, y, offset));
    if (choice !== choices) return null; // the answer to a later choice may have come before
    if (!found.pixel) {
      tell("No pixel of the map is seen there: choose another place, or choose it in the reference view.");
      return found;
    }
    const pixel = keep < 0 ? found.pixel : found.pixel.map((value, axis) => (axis === keep ? ui.pixel[keep] : value));
    ui.set({ pixel, tested: null });
    return found;
  });
}

function testDisparity(tested) {
  ui.set({ tested, plot: "costs", ...(ui.left === "refocused" ? { focus: tested } : {}) });
}

/** Measure from one pixel to another one, by default from the chosen one to the next that is chosen. */
const measure = (from = ui.pixel, pixel = from) => ui.set({ from, pixel, plot: "span" });
const spanned = () => (ui.plot === "span" && ui.pixel ? [ui.from ?? ui.pixel, ui.pixel] : null);

const [askCosts, askDifference, askSpan] = ["costs", "difference", "span"].map((name) => newest((query) => values(name, query), (found, { key }) => ui.set({ [name]: { ...found, key } })));

/** What is drawn of the chosen pixel under the map. */
function showPlot() {
  const one = entry(ui.result), isCosts = ui.plot === "costs" && Boolean(lf() && ui.pixel && one);
  $("plot").hidden = !isCosts && ui.plot !== "span";
  select("plot-tabs", ui.plot);
  const measured = spanned() && shownSource(), [[x0, y0], [x, y]] = spanned() ?? [[], []], name = measured && `${measured.key} ${spanned()}`;
  if (measured && ui.span?.key !== name) askSpan({ ...measured.query, x0, y0, x, y, key: name });
  $(ui.right === "space" || mapsBeside().length > 1 ? "results" : "plots").append($("measured")); // there, pictures stay as they are
  Object.assign($("measured"), { hidden: !measured, textContent: (measured && ui.span?.said) || "…" });
  if (measured) return plot.show(ui.span && { key: ui.span.key, x: ui.span.along, unit: "px", isSigned: true, marks: [], lines: [{ label: kindShown(), values: ui.span.values }] });
  const key = isCosts && `${state.views} ${one.identity} ${ui.stage} ${ui.pixel}`;
  if (isCosts && ui.costs?.key !== key) askCosts({ ...here(...ui.pixel, [0, 0]), key });
  const known = isCosts && ui.costs, { found, uncertainty } = known || {}, tested = ui.tested === null ? [] : [{ at: ui.tested, dashed: true }];
  return plot.show(known ? {
    key: `costs ${known.key} ${ui.tested ?? ""}`, x: known.disparities, unit: "disparity, px",
    lines: [{ label: "all views, of 255", values: known.mean, faint: true }, { label: "better half", values: known.best }],
    marks: [...(found === null ? [] : [{ at: found }]), ...tested], band: found !== null && uncertainty ? [found - uncertainty, found + uncertainty] : null,
  } : null);
}

const askHover = newest((query) => values("at", query), (found, query) => {
  if (ui.hover?.pane === query.pane) ui.set({ hover: { ...query, ...found } });
});

function point(pane, x, y) {
  if (x === null) return ui.set({ hover: null });
  if (!ui.hover) ui.set({ hover: { pane, shown: [x, y], pixel: null, values: null } });
  return askHover({ ...here(x, y, offsetOf(pane)), pane, shown: [x, y] });
}

/** What the readout, the histogram and the pictures say is of this state. */
const isToldOf = ({ revision }) => (!ui.pixel || ui.found?.of === revision)
  && [...pictures, histogram].every((one) => one.isComplete);

const askFound = newest((query) => values("at", query), (found, { of }) => ui.set({ found: { ...found, of } }));

function findPixel() {
  if (!state?.size || !ui.pixel) return;
  askFound(here(...ui.pixel, [0, 0]));
}

// --- a preview of an estimate around the pixel ---

const PREVIEW = 128; // pixels of its sides

const askPreview = newest((query) => array("preview", query), (found, query) => ui.set({ previewed: ui.preview ? { ...found, ...query } : null }));

function showPreview() {
  if (!ui.preview || !lf() || !ui.pixel) return ui.set({ previewed: null });
  const [[left, right], [top, bottom]] = ui.pixel.map((at, axis) => {
    const side = state.size[1 - axis], from = Math.max(0, Math.min(at - PREVIEW / 2, side - PREVIEW));
    return [from, Math.min(from + PREVIEW, side)];
  });
  return askPreview({ wish: JSON.stringify(estimate.wish), result: ui.result, of: state.revision, left, top, right, bottom });
}
ui.on("preview pixel", showPreview);

function drawPreview(context, { scale: size, ...place }, { data, shape: [height, width], left, top }) {
  const box = [place.left + left * size, place.top + top * size, width * size, height * size], frame = new Path2D();
  context.imageSmoothingEnabled = false;
  context.drawImage(asCanvas(paintMap(data, [height, width], scale("disparity"))), ...box);
  frame.rect(...box);
  stroke(context, frame, ["#000", 4], ["#fff", 2]);
}

// --- where things stand ---

const GAP = 6, BAR = 68, LEAST_PLOT = 132, LEAST_BESIDE = 480; // pixels
const BEYOND = 0.12; // of a range: how much more the distribution shows on either side

const outer = (box, ...except) => [...box.children].filter((child) => child !== box && !except.includes(child)).reduce((sum, child) => sum + child.offsetHeight, 0);

/** Room for the view and the EPIs directly under and beside it, and the scale at which they fit. */
function roomForViews() {
  const light = lf(), box = $("cross").parentElement;
  if (!light || !box.offsetParent) return null;
  const [height, width] = state.size, style = getComputedStyle($("cross"));
  const least = Math.min(96, Math.max(56, box.clientHeight / 8));
  const thickness = (count) => (count < 2 ? 0 : least + GAP);
  const across = box.clientWidth - parseFloat(style.marginLeft) - parseFloat(style.marginRight);
  const down = box.clientHeight - outer(box, $("cross")) - parseFloat(style.marginBottom);
  const row = thickness(light.row.length), column = thickness(light.column.length);
  return { across, down, row, column, scale: Math.max(0.01, Math.min((across - column) / width, (down - row) / height)) };
}

/** Room for some maps, and the scale at which they fit; one that is alone may have what belongs to it beside it. */
function roomForMaps(count, isAlone) {
  const box = $("maps"), pane = box.parentElement;
  if (!box.offsetParent || !state?.size) return null;
  const others = outer(pane, box, $("plots")), bar = pane.firstElementChild.offsetHeight;
  const below = pane.clientHeight > 480 && ui.plot && count === 1 ? LEAST_PLOT : 30;
  const [height, width] = state.size, margins = parseFloat(getComputedStyle(box).marginLeft) + parseFloat(getComputedStyle(box).marginRight);
  const across = pane.clientWidth - margins - BAR - GAP, down = pane.clientHeight - others - below - 2 * GAP;
  const fit = (columns, rows) => Math.min((across - (columns - 1) * GAP) / columns / width, (down - (rows - 1) * GAP) / rows / height);
  const best = [1, 2, 3, 4].map((columns) => [columns, Math.ceil(count / columns)]).sort((a, b) => fit(...b) - fit(...a))[0];
  const beside = Math.min((across - LEAST_BESIDE) / width, (pane.clientHeight - bar - 2 * GAP) / height), isBeside = isAlone && count === 1 && beside > fit(...best);
  return { columns: best[0], rows: best[1], scale: Math.max(0.01, isBeside ? beside : fit(...best)), isBeside };
}

/** View and map at the same scale, as large as they can be. */
function layout() {
  const views = roomForViews(), maps = roomForMaps(mapsBeside().length, !views);
  $("right").classList.toggle("beside", Boolean(maps?.isBeside));
  const common = views && maps ? Math.min(views.scale, maps.scale) : (views ?? maps)?.scale;
  if (views) layoutViews(views, common);
  if (maps) layoutMaps(maps, common);
}

function layoutViews({ across, down, row, column }, scale) {
  const light = lf(), [high, wide] = state.size.map((side) => Math.floor(side * scale));
  const rest = (room, count) => {
    const side = Math.min(count * 32, 340, room - GAP);
    return side > count ? count * Math.floor(side / count) : Math.floor(side);
  };
  $("epi-row").parentElement.hidden = !row;
  $("epi-column").parentElement.hidden = !column;
  $("cross").style.gridTemplate = [high, ...(row ? [rest(down - high, light.row.length)] : [])].map((side) => `${side}px`).join(" ")
    + ` / ${[wide, ...(column ? [rest(across - wide, light.column.length)] : [])].map((side) => `${side}px`).join(" ")}`;
}

function layoutMaps({ columns, rows }, scale) {
  const [height, width] = state.size, repeat = (times, side) => `repeat(${times}, ${Math.floor(side * scale)}px)`;
  $("maps").style.gridTemplate = `${repeat(rows, height)} / ${repeat(columns, width)} ${BAR}px`;
  $("colour-bar").style.gridArea = `1 / ${columns + 1} / ${rows + 1} / ${columns + 2}`;
}

/** How wide the parts are, and whether the maps are alone: so they are when some are compared side by side. */
function showWidths() {
  const main = document.querySelector("main"), isAlone = Boolean(lf()) && (ui.alone ?? mapsBeside().length > 1);
  main.classList.toggle("alone", isAlone);
  $("alone").setAttribute("aria-pressed", isAlone);
  $("alone").hidden = !lf();
  main.style.setProperty("--aside", ui.widths.aside === undefined ? "" : `${ui.widths.aside}px`);
  main.style.setProperty("--left", ui.widths.left === undefined ? "" : `${ui.widths.left}fr`);
  layout();
}

for (const gutter of document.querySelectorAll(".gutter")) {
  gutter.onpointerdown = (event) => gutter.setPointerCapture(event.pointerId);
  gutter.onpointermove = ({ clientX, buttons }) => {
    const { left, right } = (gutter.dataset.name === "aside" ? document.querySelector("main") : $("left")).getBoundingClientRect();
    if (!buttons) return;
    const end = $("right").getBoundingClientRect().right, share = Math.min(0.8, Math.max(0.2, (clientX - left) / (end - left)));
    const width = gutter.dataset.name === "left" ? share / (1 - share) : clientX - left < 120 ? 0 : Math.min(clientX - left, 520, right / 2);
    ui.set({ widths: { ...ui.widths, [gutter.dataset.name]: width } });
  };
  gutter.ondblclick = () => ui.set({ widths: { ...ui.widths, [gutter.dataset.name]: gutter.dataset.name === "aside" && ui.widths.aside === undefined ? 0 : undefined } });
}

// --- drawing what has changed ---

function showLeft() {
  const source = viewSource();
  view.show(source);
  $("focus-bar").hidden = ui.left !== "refocused";
  select("left-tabs", ui.left);
  layout();
  const title = $("left-title");
  if (!lf()) title.textContent = state ? "No light field" : "";
  else if (ui.left === "refocused") title.textContent = "Click to focus there";
  else if (ui.left === "sharp") title.textContent = source ? `Sharp everywhere, by the map “${ui.result}”` : "This needs a map: press Estimate";
  else title.replaceChildren(...viewName());
}

/** Which view it is, and how far its camera is to the right of and below the reference camera. */
function viewName() {
  const { positions, reference, counted } = lf(), [u, v] = positions[ui.view], [du, dv] = cameraPlace();
  const place = element("b", { textContent: ui.camera ? "Camera" : counted ? `Row ${v}, column ${u}` : `View ${ui.view}` });
  return [place, ui.view === reference && !ui.camera ? ", reference" : ` (${signed(du)}, ${signed(dv)})`];
}

const short = (value) => String(Number(value.toFixed(2))).replace("-", "−");
const signed = (value) => (value > 0 ? "+" : "") + short(value);

function showEpis() {
  const light = lf();
  if (!light || !ui.pixel) return;
  label("epi-row-label", `EPI, y\u00a0${ui.pixel[1]}`);
  label("epi-column-label", `EPI, x\u00a0${ui.pixel[0]}`); // a narrow one has two lines
  if (light.row.length > 1) epis[0].fetch(ui.pixel[1], state);
  if (light.column.length > 1) epis[1].fetch(ui.pixel[0], state);
}

let thumbnailsAt = -Infinity; // those of a stream are asked for once a second

function showThumbnails() {
  $("thumbnails-box").hidden = !lf();
  if (!lf()) return;
  const isDue = !state.frame || performance.now() - thumbnailsAt > 1000;
  if (isDue) thumbnailsAt = performance.now();
  thumbnails.fetch(isDue ? state.views : thumbnails.key, state.revision);
  $("view-name").replaceChildren(...viewName());
}

const named = (name, stage = FINAL) => `${entry(name)?.isTruth ? "ground truth" : name}${stage === FINAL ? "" : `, after ${stage}`}`;

/** The maps that stand beside each other: names, the first one first. */
const mapsBeside = () => (ui.compare === "side" ? [ui.result, ...OTHERS.map((name) => ui[name])].filter((name) => entry(name)) : [ui.result]);

function showMaps() {
  const one = entry(ui.result), other = entry(ui.other), quantity = fixed.quantities[ui.quantity], beside = mapsBeside();
  const first = mapSource(ui.result, ui.quantity, ui.stage), second = other && mapSource(ui.other);
  const mode = second ? ui.compare : "one", minus = mode === "minus" && shownSource();
  otherMaps.forEach((picture, k) => {
    const name = beside[k + 1];
    picture.canvas.parentElement.hidden = !name;
    picture.canvas.nextElementSibling.textContent = name ? named(name) : "";
    picture.show(name ? mapSource(name) : null);
  });
  showWidths();
  if (minus && ui.difference?.key !== minus.key) askDifference({ ...minus.query, key: minus.key });
  if (mode === "wipe") map.show(first, second);
  else map.show(minus || (mode === "flip" && ui.flipped ? second : first));
  const firstName = mode === "flip" && ui.flipped ? named(ui.other) : one && named(ui.result, ui.stage);
  label("map-label", one && (mode === "wipe" ? `◀ ${firstName}` : minus ? `${firstName} − ${named(ui.other)}` : firstName));
  const lacks = other?.isTruth && ui.quantity === "error" ? "errors are against the ground truth" : `${named(ui.other)} has no ${quantity.label.toLowerCase()}`;
  label("wipe-label", mode === "wipe" ? `${named(ui.other)} ▶` : other && !second && lacks);
  label("map-note", !one && `No map yet: press Estimate${phone.matches ? " in Settings" : ""}.`);
  const inUnits = ({ label, unit }) => [label, unit && ` (${unit})`], hint = [quantity.hint, "grey: undefined"].filter(Boolean).join("; ");
  const painted = fixed.quantities[ui.paint], shares = (minus && ui.difference?.shares) || null, isAlone = one?.isTruth && state.results.every(({ isTruth }) => isTruth);
  const of = one && ` of ${named(ui.result, ui.stage)}`, [what, words] = !one ? ["", ""]
    : ui.right === "space" ? [ui.mesh ? "Surface" : "Points", painted ? `${of}; colour: ${inUnits(painted).join("").toLowerCase()}` : of]
    : shares ? ["Difference", shares.map(([threshold, share]) => ` ${Number(share.toPrecision(2))} % > ${threshold}`).join(",")]
    : [first ? quantity.label : `No ${quantity.label.toLowerCase()}`, of + inUnits(quantity)[1] + (isAlone ? "; no estimate yet" : one.earlier ? "; of another frame" : "")];
  $("right-title").replaceChildren(element("b", { textContent: what }), words);
  $("right-title").title = [what + words, hint].join("\n");
  space.note(one ? "" : `No map yet: press Estimate${phone.matches ? " in Settings" : ""}.`);
  showHistogram();
  const { colours, low, high } = scale();
  drawScale($("colour-bar"), first || second ? scale() : { low: 0, high: 0 });
  showSpaceScale();
  fill($("colours"), Object.keys(fixed.colours).map((name) => [name, COLOURS[name] ?? name]), colours);
  for (const [id, value] of [["low", low], ["high", high]]) {
    if (document.activeElement !== $(id)) $(id).value = roundedTo((high - low) / 1000, value);
  }
  $("seen").disabled = !shownSource();
  $("auto").disabled = !ui.ranges[kindShown()];
}

function showSpaceScale() {
  $("space-bar").hidden = ui.paint === PICTURE;
  drawScale($("space-bar"), entry(ui.result)?.kinds.includes(ui.paint) ? scale(ui.paint) : { low: 0, high: 0 });
}

/** A value with as many digits as tell it from others that are `apart`, so that it can be read in a narrow field. */
function roundedTo(apart, value) {
  const digits = Math.max(0, Math.min(9, -Math.floor(Math.log10(apart))));
  return Number.isFinite(digits) ? Number(value.toFixed(digits)) : value;
}

/** How the values of the map are distributed, with that of the chosen pixel. */
function showHistogram() {
  const source = shownSource(), isShown = source && ui.right !== "space";
  $("plots").hidden = !isShown;
  $("plots").classList.toggle("folded", !ui.plot);
  $("histogram").hidden = ui.plot !== "values";
  const { values = {}, other = {} } = ui.found ?? {}, value = values[ui.quantity] ?? NaN, isWanted = isShown && ui.plot === "values";
  const { colours, low, high, extent = [low, high] } = scale(), margin = BEYOND * (high - low), count = Math.max(16, Math.min(256, $("histogram").clientWidth >> 2));
  const from = Math.max(low - margin, Math.min(low, extent[0])), to = Math.min(high + margin, Math.max(high, extent[1]));
  const key = isWanted && `${source.key} ${from} ${to} ${count}`;
  if (isWanted && to > from && $("histogram").clientWidth && bars?.key !== key) askBars({ ...source.query, low: from, high: to, bins: count, key });
  const x = Array.from({ length: count }, (_, k) => from + ((k + 0.5) / count) * (to - from)), point = isMinus() ? value - (other[ui.quantity] ?? NaN) : value;
  histogram.show(isWanted ? {
    key, x, unit: "%", range: [low, high], marks: Number.isFinite(point) ? [{ at: point }] : [],
    lines: bars?.key === key ? [{ values: bars.data, faint: true, fills: x.map((each) => css(colours, (each - low) / (high - low))) }] : [],
  } : null);
  showPlot();
}

function label(id, text) {
  $(id).hidden = !text;
  $(id).textContent = text || "";
}

function showChoices() {
  if (!state) return;
  const quantities = Object.entries(fixed.quantities).filter(([name]) => state.results.some((one) => one.kinds.includes(name)));
  $("quantity").disabled = $("result").disabled = $("other").disabled = !state.results.length;
  fill($("quantity"), quantities.map(([name, { label }]) => [name, label]), ui.quantity);
  const names = state.results.map(({ name, isTruth, earlier }) => [name, isTruth ? "ground truth" : earlier ? `${name} (another frame)` : name]);
  fill($("result"), names.length ? names : [[NOTHING, "none yet"]], ui.result);
  for (const name of OTHERS) fill($(name), [[NOTHING, "nothing"], ...names.filter(([each]) => each !== ui.result)], ui[name]);
  $("more").hidden = !ui.other || ui.compare !== "side" || names.length < 3;
  const one = entry(ui.result);
  fill($("stage"), [[FINAL, FINAL], ...(one?.stages ?? []).map((stage) => [stage, `after ${stage}`])], ui.stage);
  $("stage").parentElement.hidden = !one?.stages.length;
  $("compare").hidden = !ui.other;
  select("compare", ui.compare, "aria-checked");
  $("about").textContent = $("about").title = one?.isTruth
    ? "The ground truth: it is not an estimate." : [one?.about, one?.earlier && "It belongs to another frame."].filter(Boolean).join(" ");
  const scored = state.results.filter(({ scores }) => scores);
  $("scores").hidden = !scored.length;
  const cell = (value, digits) => element("td", { textContent: value === null ? "–" : value.toFixed(digits) });
  $("scores").tBodies[0].replaceChildren(...scored.map(({ name, scores: { mse, bad07, bad03, bad01, q25 } }) => element(
    "tr", { className: name === ui.result ? "chosen" : "" }, element("td", { textContent: name, title: name }),
    cell(mse, 2), cell(bad07, 2), cell(bad03, 2), cell(bad01, 1), cell(q25, 2),
  )));
  const paints = [...(lf() ? [[PICTURE, "picture"]] : []), ...quantities.map(([name, { label }]) => [name, label.toLowerCase()])];
  if (!paints.some(([name]) => name === ui.paint)) ui.paint = paints[0]?.[0] ?? PICTURE;
  fill($("space-paint"), paints, ui.paint);
  $("space-metric").disabled = !state.metric;
  $("space-metric").value = ui.metric && state.metric ? "1" : "";
  $("space-cameras").disabled = !(state.metric && ui.metric && lf());
  $("space-cameras").parentElement.title = state.metric ? "" : "The place of cameras needs a geometry";
}

function showParts() {
  const isSpace = ui.right === "space";
  select("right-tabs", ui.right);
  $("maps").hidden = isSpace;
  $("space").hidden = $("space-section").hidden = !isSpace;
  const part = document.body.dataset.show;
  for (const button of document.querySelectorAll("nav button")) button.setAttribute("aria-current", button.dataset.value === part);
  layout();
}

function showReadout() {
  const at = ui.hover?.values ? ui.hover : ui.found && { ...ui.found, pane: null };
  const said = [];
  if (at) {
    const inView = at.pane && offsetOf(at.pane).some(Boolean);
    if (inView) said.push(part("in the view", `${at.shown[0]}, ${at.shown[1]}`, ""));
    const pixel = at.pixel ? `${at.pixel[0]}, ${at.pixel[1]}` : "not in the map";
    said.push(part(at.pane ? (inView ? "in the reference" : "x, y") : "chosen x, y", pixel, ""));
    if (ui.tested !== null && !at.pane) said.push(part("tested", number(ui.tested), "px"));
    if (entry(ui.result)?.isTruth) said.push(part("of the", named(ui.result), ""));
    for (const [kind, value] of Object.entries(at.values)) {
      const { label, unit } = fixed.quantities[kind];
      const other = at.other[kind];
      said.push(part(label.toLowerCase(), number(value), value === null ? "" : unit.replace(" per view step", "")));
      if (ui.other && other !== undefined && kind === ui.quantity) said.push(part(named(ui.other), number(other), "", "dim"));
    }
    if (at.colour) said.push(part("colour", at.colour.map((value) => (Number.isInteger(value) ? value : number(value, 3))).join(" "), ""));
  }
  $("readout").replaceChildren(...said);
}

const part = (name, value, unit, className = "") => element(
  "span", { className }, element("span", { className: "dim", textContent: `${name} ` }), element("b", { textContent: value }), unit && ` ${unit}`,
);

function select(id, chosen, attribute = "aria-selected") {
  for (const button of $(id).querySelectorAll("button")) {
    button.setAttribute(attribute, button.dataset.value === chosen);
    button.setAttribute("role", attribute === "aria-checked" ? "radio" : "tab");
  }
}

ui.on("view camera left result stage focus aperture exposure gamma", showLeft);
ui.on("view camera exposure gamma", showThumbnails);
ui.on("pixel exposure gamma", showEpis);
ui.on("pixel result stage other", findPixel);
ui.on("found view camera left", showHistogram);
ui.on("quantity result stage other third fourth compare flipped colourMaps ranges right mesh paint difference plot", showMaps);
ui.on("alone widths plot", showWidths);
ui.on("costs tested pixel from span", showPlot);
ui.on("quantity result stage other third fourth compare metric paint", showChoices);
ui.on("result", showFindings);
ui.on("right", showParts);
ui.on("hover found other quantity tested", showReadout);
ui.on("found view camera left costs tested pixel from span previewed hover", () => [...pictures, ...epis].forEach((one) => one.draw()));

// --- the state of the server ---

const estimate = new Estimate(fixed.presets, showPreview);

const PATIENCE = 2000; // milliseconds that pictures have to come before the next state is taken

let later = null, takenAt = 0;

/** Take the state of the server, a stream's when what is shown of the last one is there: else nothing would ever be. */
function take(next) {
  const isStream = state && next.revision !== state.revision && next.results.some(({ name }) => name === fixed.live);
  if (isStream && performance.now() - takenAt < PATIENCE && !isToldOf(state)) {
    if (!later) setTimeout(takeLater, PATIENCE);
    later = next;
    return;
  }
  later = null;
  takenAt = performance.now();
  takeNow(next);
  send({ taken: next.revision });
}

function takeLater() {
  if (later) take(later);
}
ui.on("found", takeLater);

function takeNow(next) {
  const before = state;
  state = next;
  takenLast = performance.now();
  const other = !before || before.lightField?.name !== state.lightField?.name || String(before.size) !== String(state.size)
    || before.lightField?.views !== state.lightField?.views;
  const span = state.scales.disparity?.limits ?? [-3, 3], margin = 0.2 * (span[1] - span[0]);
  [$("focus").min, $("focus").max] = [span[0] - margin, span[1] + margin];
  if (other && state.size) {
    $("aperture").max = lf()?.aperture ?? 1;
    viewport.fit(state.size);
  }
  // all at once: a view of the last light field may not be one of this
  ui.set({ ...(other && state.size ? beginning() : {}), ...chosenMaps(before, other) });
  if (!sight && state.size) {
    const hash = location.hash.slice(1); // before anything is kept there
    sight = new Sight(ui, viewport, () => !home && !state.frame, applySight);
    sight.open(hash);
  }
  $("left").hidden = !lf();
  document.querySelector("main").hidden = $("readout").hidden = !state.size;
  $("nothing").hidden = Boolean(state.size || state.loading);
  for (const id of ["views-section", "brightness-section"]) $(id).hidden = !lf();
  for (const id of ["map-section", "colours-section"]) $(id).hidden = !state.results.length;
  document.querySelector("main").classList.toggle("maps-only", !lf());
  document.querySelector("nav [data-value=view]").disabled = !lf();
  if (!lf() && document.body.dataset.show === "view") showPart("map");
  showFindings();
  showLoading(); // these first: the pictures get the room that the rest leaves
  showStream();
  film.show();
  if (!before || other || state.revision !== before.revision) {
    document.title = [lf()?.name, "lfgpu"].filter(Boolean).join(" – ");
    $("name").textContent = lf()?.name ?? state.results[0]?.name ?? "";
    $("facts").textContent = facts();
    showChoices();
    showLeft();
    showThumbnails();
    showEpis();
    showMaps();
    findPixel();
    if (ui.hover?.shown) point(ui.hover.pane, ...ui.hover.shown);
  }
  estimate.progress(state.progress, Boolean(lf()));
  space.refresh();
}

let sight = null;

/** Show what a link says, as far as it is there. */
function applySight(values) {
  const [height, width] = state.size, inside = ([x, y]) => x >= 0 && y >= 0 && x < width && y < height;
  if (!lf()?.offsets[values.view]) Object.assign(values, { view: lf()?.reference ?? 0, camera: null });
  if (!values.pixel || !inside(values.pixel)) values.pixel = ui.pixel;
  for (const name of ["result", ...OTHERS]) if (!entry(values[name])) values[name] = name === "result" ? ui.result : NOTHING;
  ui.set(values);
  ui.set(chosenMaps(state, false));
}

/** What a tab shows of a light field that it has not shown before. */
function beginning() {
  const [height, width] = state.size, light = lf();
  return {
    view: light?.reference ?? 0, camera: null, exposure: light?.exposure ?? 0, gamma: 1, pixel: [Math.floor(width / 2), Math.floor(height / 2)], hover: null, found: null, from: null, previewed: null,
    focus: 0, aperture: light?.aperture ?? 0, ranges: {}, metric: true, ...(light ? {} : { left: "view" }),
  };
}

function facts() {
  const light = lf();
  if (!light) return state.size ? `${state.size[1]} × ${state.size[0]} pixels` : "";
  const [rows, columns] = light.grid ?? [1, light.views], isWhole = rows * columns === light.views;
  const views = light.grid ? `${isWhole ? "" : `${light.views} of `}${rows} × ${columns} views` : `${light.views} views`;
  return `${views}, ${state.size[1]} × ${state.size[0]} pixels, ${light.stored}${light.channels === 1 ? ", grey" : ""}`;
}

/** What is shown of the maps that there are now: the newest one, or the one that was chosen, or the first estimate. */
function chosenMaps(before, other) {
  const names = state.results.map(({ name }) => name), known = new Set((other ? null : before)?.results.map(({ name }) => name));
  let { result, stage, other: beside, quantity } = ui;
  const isNew = state.newest !== null && names.includes(state.newest) && !known.has(state.newest);
  if (isNew) {
    if (known.has(result) && !entry(result)?.isTruth && !beside && state.newest !== fixed.live) beside = result;
    result = state.newest;
  } else if (!names.includes(result)) {
    result = state.results.find(({ isTruth }) => !isTruth)?.name ?? names[0] ?? NOTHING;
  }
  if (!names.includes(beside) || beside === result) beside = NOTHING;
  if (!entry(result)?.stages.includes(stage)) stage = FINAL;
  if (result && !entry(result).kinds.includes(quantity)) quantity = "disparity";
  return { result, stage, other: beside, quantity };
}

/** What may be wrong with what is shown, and what to do about it; commands stand between backquotes. */
function showFindings() {
  const said = [...(lf()?.findings ?? []), ...(entry(ui.result)?.findings ?? [])], box = $("findings");
  const words = (text) => text.split("`").map((part, k) => (k % 2 ? element("code", { textContent: part }) : part));
  box.hidden = !said.length;
  box.firstElementChild.replaceChildren(said.length === 1 ? "1 finding" : `${said.length} findings`);
  box.lastElementChild.replaceChildren(...said.map((text) => element("li", {}, ...words(text))));
  const read = lf()?.read ?? [];
  $("read").hidden = !read.length;
  $("read").replaceChildren($("read").firstElementChild, ...read.map((textContent) => element("p", { textContent, className: "muted" })));
}

let takenLast = 0;

function showLoading() {
  const { text, seconds } = state?.loading ?? {};
  $("loading").hidden = !text;
  $("loading-text").textContent = `${text} (${Math.floor(seconds + (performance.now() - takenLast) / 1000)} s)`;
}
setInterval(showLoading, 500);

function showStream() {
  const { rate, latency, dropped, paused, recording, switches } = state.stream;
  const said = [
    paused ? "paused" : "", recording ? "recording" : "",
    rate === null ? "" : `${rate.toFixed(1)} frames/s`,
    latency === null ? "" : `${(1000 * latency).toFixed(0)} ms latency`,
    dropped === null ? "" : `${dropped} dropped`,
  ].filter(Boolean);
  $("stream").hidden = !said.length && !switches.length;
  $("stream-facts").textContent = said.join(" · ");
  for (const [id, on, words] of [["pause", paused, ["Pause", "Go on"]], ["record", recording, ["Record", "Stop recording"]]]) {
    $(id).hidden = !switches.includes(id);
    $(id).textContent = words[Number(on)];
    $(id).onclick = () => orTell(() => act("switch", { name: id, on: !on }));
  }
}

// --- what people do ---

const SAID = { // of sliders
  exposure: signed, gamma: (value) => value.toFixed(2), focus: (value) => `${short(value)} px`, aperture: (value) => `${short(value)} steps`,
  least: (value) => value.toFixed(2), size: (value) => value.toFixed(1),
};
for (const field of document.querySelectorAll("[data-ui]")) { // each shows a value of this tab, and sets it
  const name = field.dataset.ui, isBoolean = typeof ui[name] === "boolean", show = () => {
    if (field.type === "checkbox") field.checked = ui[name];
    else field.value = isBoolean ? (ui[name] ? "1" : "") : ui[name];
    if (name in SAID) field.nextElementSibling.textContent = SAID[name](ui[name]);
  };
  field.oninput = () => ui.set({ [name]: field.type === "range" ? field.valueAsNumber : field.type === "checkbox" ? field.checked : isBoolean ? Boolean(field.value) : field.value });
  ui.on(name, show);
  show();
}
$("space-start").onclick = () => space.startOver();
$("as-stored").onclick = () => ui.set({ exposure: 0, gamma: 1 });
$("colours").onchange = () => ui.set({ colourMaps: { ...ui.colourMaps, [kindShown()]: $("colours").value } });
$("auto").onclick = () => ui.set({ ranges: { ...ui.ranges, [kindShown()]: null } });
$("seen").onclick = () => orTell(async () => {
  const { left, top, scale: size } = viewport.place(map), { width, height } = map.canvas, at = (start, room) => Math.round((room - start) / size);
  const { limits } = await values("seen", { ...shownSource().query, left: at(left, 0), top: at(top, 0), right: at(left, width), bottom: at(top, height) });
  ui.set({ ranges: { ...ui.ranges, [kindShown()]: limits } });
});
for (const id of ["low", "high"]) {
  $(id).onchange = () => {
    const [low, high] = [$("low").valueAsNumber, $("high").valueAsNumber];
    if (low < high) ui.set({ ranges: { ...ui.ranges, [kindShown()]: [low, high] } });
    else tell("The range must go from a smaller to a larger number.");
  };
}
const press = (id, act) => ($(id).onclick = (event) => event.target.dataset.value && act(event.target.dataset.value));
function showLeftAs(left) {
  const disparity = ui.found?.values.disparity; // the focus begins at the chosen pixel
  ui.set({ left, hover: null, ...(left === "refocused" && ui.left !== left && Number.isFinite(disparity) ? { focus: disparity } : {}) });
}
press("left-tabs", showLeftAs);
press("right-tabs", (value) => ui.set({ right: value }));
$("plot-tabs").onclick = ({ target }) => target.dataset.value === "span" ? measure() : "value" in target.dataset && ui.set({ plot: target.dataset.value || (ui.plot ? "" : "values") });
const toggleAlone = () => ui.set({ alone: !document.querySelector("main").classList.contains("alone") });
$("alone").onclick = toggleAlone;
press("compare", (value) => ui.set({ compare: value, flipped: value === "flip" && !ui.flipped }));
document.querySelector("nav").onclick = (event) => event.target.dataset.value && showPart(event.target.dataset.value);

function showPart(value) {
  document.body.dataset.show = value;
  if (value === "map" || value === "space") ui.set({ right: value });
  showParts();
  requestAnimationFrame(() => viewport.changed());
}

function walk(by) {
  const names = state.results.map(({ name }) => name);
  if (names.length) ui.set({ result: names[(names.indexOf(ui.result) + by + names.length) % names.length] });
}

function enlarge(factor, one = map.canvas.offsetParent ? map : view) {
  viewport.enlarge(one, one.canvas.width / 2, one.canvas.height / 2, factor);
}

const KEYS = {
  r: () => lf() && chooseView(lf().reference),
  w: () => {
    ui.set({ sway: !(ui.sway ?? canSway()) });
    if (ui.sway) sway.start();
  },
  f: () => viewport.fit(),
  "+": () => enlarge(1.5),
  "=": () => enlarge(1.5),
  "-": () => enlarge(1 / 1.5),
  "[": () => walk(-1),
  "]": () => walk(1),
  t: () => ui.other && ui.set({ compare: "flip", flipped: ui.compare === "flip" ? !ui.flipped : true }),
  v: () => showLeftAs("view"),
  o: () => lf() && showLeftAs("refocused"),
  a: () => lf() && showLeftAs("sharp"),
  m: () => showPart("map"),
  d: () => showPart("space"),
  s: () => $("save-files").click(),
  ",": () => film.step(-1),
  ".": () => film.step(1),
  p: () => film.toggle(),
  x: toggleAlone,
  l: () => state?.size && measure(),
  escape: () => ui.set({ tested: null, from: null, plot: ui.plot === "span" ? "values" : ui.plot }),
  "?": () => $("help").showModal(),
};
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

// Who chose with a pointer goes on with the keys of the page; who came by the keyboard keeps those of the field.
let isPointing = false;
document.addEventListener("pointerdown", () => (isPointing = true), true);
document.addEventListener("change", ({ target }) => isPointing && target.matches(CHOICES) && target.blur());
const CHOICES = "select, [type=checkbox], [type=range]";

function pressed(event) {
  const field = event.target.closest?.("input, select, textarea"), isChosen = isPointing && field?.matches(CHOICES);
  isPointing = false;
  if ((event.ctrlKey || event.metaKey) && event.key === "z" && !(field && !field.matches(CHOICES))) {
    event.preventDefault();
    sight?.undo();
  }
  if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
  if (isChosen) field.blur();
  else if (field) return;
  const arrow = ARROWS[event.key], number = Number(event.key);
  if (arrow && state?.size) {
    event.preventDefault();
    if (event.shiftKey) {
      const inside = (value, side) => Math.min(Math.max(value, 0), side - 1);
      ui.set({ pixel: [inside(ui.pixel[0] + arrow[0], state.size[1]), inside(ui.pixel[1] + arrow[1], state.size[0])] });
    } else if (lf()) chooseView(neighbour(lf(), ui.view, ...arrow));
  } else if (number >= 1 && number <= $("quantity").options.length) {
    ui.set({ quantity: $("quantity").options[number - 1].value });
  } else if (KEYS[event.key.toLowerCase()]) {
    event.preventDefault();
    KEYS[event.key.toLowerCase()]();
  }
}
document.addEventListener("keydown", pressed);
$("open-help").onclick = () => $("help").showModal();

function placeThumbnails() {
  $(phone.matches ? "thumbnails-phone" : "thumbnails-home").append($("thumbnails-box"));
  thumbnails.draw();
}
phone.addEventListener("change", placeThumbnails);
placeThumbnails();
const resized = new ResizeObserver(() => state && showMaps());
for (const name of ["left", "right", "results", "histogram"]) resized.observe($(name));
new ResizeObserver(() => state && showSpaceScale()).observe($("space-bar"));
dark.addEventListener("change", () => {
  showMaps();
  space.refresh();
});

setUpFiles(fixed.formats, () => ({
  state, ui, mapSource: mapSource(ui.result, ui.quantity, ui.stage), viewSource: viewSource(), scale: scale(), tab: space.tab,
}));

// --- points in space ---

let wasShown = false;

function scene() {
  if (!state?.size || (ui.right !== "space" && !wasShown)) return null;
  wasShown = true;
  const kind = ui.paint === PICTURE ? "disparity" : ui.paint, { colours, low, high } = scale(kind), box = $("space-frame").getBoundingClientRect();
  const page = dark.matches ? "dark" : "light";
  return {
    result: ui.result, stage: ui.stage, metric: ui.metric && state.metric, paint: ui.paint, colours, low, high,
    exposure: ui.exposure, gamma: ui.gamma, least: ui.least, size: ui.size, mesh: ui.mesh, cameras: ui.cameras, background: ui.background === "page" ? page : ui.background,
    aspect: box.height ? box.width / box.height : 1, x: ui.pixel?.[0] ?? 0, y: ui.pixel?.[1] ?? 0,
    orbit: ui.orbit, x0: spanned()?.[0][0] ?? -1, y0: spanned()?.[0][1] ?? -1,
  };
}

const send = connect((words) => {
  if (words.tab) space.belong(words.tab);
  if (words.state) take(words.state);
  if (words.space) space.ready();
  if (words.joined) space.joined();
  if (words.picked) ui.set({ pixel: words.picked });
  if (words.message) tell(words.message);
}, (isThere) => {
  $("gone").hidden = isThere;
  document.body.classList.toggle("gone", !isThere);
});
const space = new Space(send, scene, pressed);
ui.on("background", () => ($("space-frame").style.background = ui.background === "page" ? "" : ui.background));
ui.on("right result stage metric paint exposure gamma least size mesh cameras background pixel colourMaps ranges orbit from plot", () => space.refresh());
showParts();
