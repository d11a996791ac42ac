// Everything that is asked of the server, relative to the address of the page, which has the token.

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

/** Ask for something to be done. */
export async function act(what, wish = {}) {
  await checked(await fetch(`do/${what}`, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(wish),
  }));
}

/** A file of the server, to be saved by the browser. */
export async function download(what, query) {
  const answer = await checked(await fetch(address(`file/${what}`, query)));
  offer(await answer.blob(), decodeURIComponent(answer.headers.get("Content-Disposition").split("''")[1]));
}

export function offer(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** Ask one thing at a time and skip what was asked in between: `ask(query)` calls `then(answer)` for the newest. */
export function newest(work, then) {
  let busy = false, next = null;
  const ask = async (query) => {
    if (busy) {
      next = query;
      return;
    }
    busy = true;
    try {
      then(await work(query), query);
    } catch { /* the server has gone, or what was asked for has: the newest state says so */ }
    busy = false;
    if (next !== null) {
      const query = next;
      next = null;
      ask(query);
    }
  };
  return ask;
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
