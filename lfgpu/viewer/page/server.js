// Everything that is asked of the server, relative to the address of the page, which has the token.

import { offer } from "./asking.js";

export { newest, offer } from "./asking.js";

const TYPES = { uint8: Uint8Array, uint16: Uint16Array, float32: Float32Array };

const address = (path, query) => `${path}?${new URLSearchParams(query)}`;

async function checked(answer) {
  if (answer.ok) return answer;
  let sentence = `the server answered ${answer.status}.`;
  try {
    sentence = (await answer.json()).error ?? sentence;
  } catch { /* no sentence came with it */ }
  throw Object.assign(new Error(sentence), { isGone: answer.status === 410 });
}

/** An array from the server: { data, shape }. */
export async function array(what, query) {
  const answer = await checked(await fetch(address(`data/${what}`, query)));
  const shape = answer.headers.get("X-Shape").split(",").map(Number);
  return { data: new TYPES[answer.headers.get("X-Type")](await answer.arrayBuffer()), shape };
}

export async function values(what, query = {}) {
  return (await checked(await fetch(address(`data/${what}`, query)))).json();
}

/** Ask for something to be done; true when it is. */
export async function act(what, wish = {}) {
  return Boolean(await checked(await fetch(`do/${what}`, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(wish),
  })));
}

/** A file of the server, to be saved by the browser. */
export async function download(what, query) {
  const answer = await checked(await fetch(address(`file/${what}`, query)));
  offer(await answer.blob(), decodeURIComponent(answer.headers.get("Content-Disposition").split("''")[1]));
}

/** Stay connected: `heard(words)` for each message, `there(true or false)` when the server comes or goes. */
export function connect(heard, there) {
  let socket = null;
  const open = () => {
    const place = new URL("tab", location.href);
    place.protocol = place.protocol.replace("http", "ws");
    socket = new WebSocket(place);
    socket.onopen = () => there(true);
    socket.onmessage = (event) => heard(JSON.parse(event.data));
    socket.onclose = () => {
      there(false);
      setTimeout(open, 1500);
    };
  };
  open();
  return (words) => {
    if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(words));
  };
}
