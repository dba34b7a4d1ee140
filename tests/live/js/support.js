/** What the tests share: pages' modules, vectors, and a room of the tests' own at the other end of a socket. */

import { readFile } from "node:fs/promises";

export const PAGES = new URL("../../../synchronizar/live/pages/", import.meta.url);

export async function vectors(name) {
  return JSON.parse(await readFile(new URL(`../vectors/${name}.json`, import.meta.url), "utf8"));
}

/** Lets all promises that are settled go on. */
export async function settled() {
  for (let i = 0; i < 20; i++) await Promise.resolve();
}

/** Sockets that a client opened, each with what was sent through it. */
export function fakeNetwork({ refuse = [], joined = {} } = {}) {
  const sockets = [];
  const joins = [];
  class FakeSocket {
    constructor(address) {
      Object.assign(this, { address, sent: [], bufferedAmount: 0, closed: false });
      sockets.push(this);
    }
    send(data) {
      this.sent.push(typeof data === "string" ? JSON.parse(data) : data);
    }
    close() {
      this.closed = true;
    }
    say(message) {
      this.onmessage({ data: message instanceof ArrayBuffer ? message : JSON.stringify(message) });
    }
    words(type) {
      return this.sent.filter((word) => word.type === type);
    }
    get poses() {
      return this.sent.filter((word) => word instanceof ArrayBuffer);
    }
  }
  async function fetch(address, { body }) {
    joins.push({ address: String(address), ...JSON.parse(body) });
    const refused = refuse.shift();
    if (refused === "network") throw new TypeError("fetch failed");
    const answer = refused ?? { token: `token ${joins.length}`, resume: "again", room: "CODE", users: [], ...joined };
    return { ok: !refused, status: refused ? 400 : 200, json: async () => answer };
  }
  return { sockets, joins, WebSocket: FakeSocket, fetch };
}

/** A `welcome` for a client that speaks for `you`. */
export function welcome(you, more = {}) {
  const members = you.map((name, index) => ({ name, index }));
  const frames = { type: "frames", version: 0, t: 100, reference: null, users: {} };
  return { type: "welcome", room: "CODE", you, protocol: 1, t: 100, members, frames, objects: { version: 0 }, ...more };
}
