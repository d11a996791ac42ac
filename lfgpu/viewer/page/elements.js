// Small help with elements of the page. All text goes in as text, never as HTML.

export const $ = (id) => document.getElementById(id);

export function element(name, values = {}, ...children) {
  const made = Object.assign(document.createElement(name), values);
  made.append(...children);
  return made;
}

/** Give a canvas as many pixels as the screen has there; returns how many for each of the page. */
export function fitted(canvas) {
  const ratio = window.devicePixelRatio;
  canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
  canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  return ratio;
}

/** Draw a path in strokes of [style, pixels of the page], one over the other. */
export function stroke(context, path, ...strokes) {
  for (const [strokeStyle, wide] of strokes) {
    Object.assign(context, { strokeStyle, lineWidth: wide * window.devicePixelRatio });
    context.stroke(path);
  }
}

/** Fill a list with [value, text] pairs and choose one. */
export function fill(select, options, chosen) {
  const wanted = JSON.stringify(options);
  if (select.dataset.options !== wanted) {
    select.replaceChildren(...options.map(([value, text]) => element("option", { value, textContent: text })));
    select.dataset.options = wanted;
  }
  select.value = chosen;
}

/** A message that stays until somebody closes it, or for some seconds. */
export function tell(text) {
  const box = element("div", { textContent: text });
  box.append(element("button", { textContent: "×", ariaLabel: "Close", onclick: () => box.remove() }));
  document.getElementById("messages").append(box);
  setTimeout(() => box.remove(), 15_000);
}

/** Do something; tell what went wrong. */
export async function orTell(work) {
  try {
    return await work();
  } catch (error) {
    tell(error instanceof TypeError ? "The server does not answer." : error.message);
    return undefined;
  }
}

export function number(value, digits = 4) {
  if (value === null || value === undefined) return "undefined";
  const text = Math.abs(value) >= 1e6 || (value !== 0 && Math.abs(value) < 1e-4) ? value.toExponential(2) : value.toFixed(
    Math.min(6, Math.max(0, digits - 1 - Math.floor(Math.log10(Math.max(Math.abs(value), 0.1))))),
  );
  return text.replace("-", "−");
}
