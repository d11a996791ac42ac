// Asking one thing at a time, and files for the browser to save.

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
