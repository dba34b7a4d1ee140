/** What an application adds to a page: the module `phone.js` or `room.js` of its folder, where it has one. */

import { serverAddress } from "./visit.js";

/** Its export `begin`, or null where it has nothing for that page. `app`: its name, as `welcome` says it. */
export async function appLayer(app, page) {
  if (!app) return null;
  try {
    const { begin } = await import(new URL(`apps/${encodeURIComponent(app)}/${page}.js`, serverAddress()).href);
    return begin ?? null;
  } catch {
    return null;
  }
}
