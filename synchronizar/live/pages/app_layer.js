/** What an application adds to a page: the module `phone.js` or `room.js` of its folder, where it has one. */

import { serverAddress } from "./visit.js";

/**
 * Its exports: `begin`, null where it has nothing for that page, and `features`, what of WebXR it wants. `app`: its name,
 * as `welcome` says it.
 */
export async function appLayer(app, page) {
  const nothing = { begin: null, features: [] };
  if (!app) return nothing;
  try {
    return { ...nothing, ...(await import(new URL(`apps/${encodeURIComponent(app)}/${page}.js`, serverAddress()).href)) };
  } catch {
    return nothing;
  }
}
