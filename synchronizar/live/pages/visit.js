/** What a page knows of its visitor: the room's code in the address's fragment, the rest in this tab's own memory. */

const KEY = "synchronizar";

/** The room's code, as it stands behind the # of the address, without spaces and dashes; "" where there is none. */
export function codeOf(hash = location.hash) {
  let text = hash.slice(1);
  try {
    text = decodeURIComponent(text);
  } catch {
    // A stray % is no code either; the room says so.
  }
  return text.toUpperCase().replace(/[\s-]/g, "");
}

/** A code as people read it aloud: ABCD-EFGH. */
export function spelled(code) {
  return code.replace(/(.{4})(?=.)/g, "$1-");
}

/** The server's address, whatever stands before its pages in it. */
export function serverAddress() {
  return new URL(".", location.href).href;
}

/** The address of another page of the same room. */
export function addressOf(path, code) {
  return `${path}#${encodeURIComponent(code)}`;
}

/** What was remembered in this tab of a room: {name, resume, note}. It outlives a reload, not the tab. */
export function recalled(code) {
  try {
    const memory = JSON.parse(sessionStorage.getItem(KEY) ?? "{}");
    return memory.code === code ? memory : {};
  } catch {
    return {};
  }
}

/** Remember some of it. */
export function remember(code, change) {
  try {
    sessionStorage.setItem(KEY, JSON.stringify({ ...recalled(code), ...change, code }));
  } catch {
    // A browser that keeps nothing: a reload then joins as somebody else.
  }
}
