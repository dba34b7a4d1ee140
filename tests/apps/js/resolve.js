/** In Node, where no server puts an application's pages beside the room's own: see hooks.js. */

import { register } from "node:module";

register("./hooks.js", import.meta.url);
