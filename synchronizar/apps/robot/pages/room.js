/** Robots on the room's page: what each does, and where its mirror stands. */

import { element, keep, say } from "../../pages/dom.js";
import { others } from "../../pages/looks.js";
import { Gallery } from "../../pages/stills.js";
import { entry, entryKey, sayLine } from "../../pages/xr/looking.js";
import { ORDER, orders } from "./orders.js";

const HALF_M = 1.5;

/** `place`: what the room's page has, see docs/apps.md. */
export function begin({ client, panel }) {
  const list = element("ul", { class: "app-list" });
  const none = element("p", { class: "quiet", text: "No robot is here yet." });
  const stop = element("button", { type: "button", text: "Stop all robots" });
  stop.addEventListener("click", () => client.say("stay", {}, "app"));
  const [seen, gallery] = [element("ul", { class: "app-list" }), new Gallery()];
  const views = element("div", { class: "app-views" });
  panel.append(element("h2", { text: "Robots" }), none, list, stop, element("h2", { text: "What they see" }), views, seen);
  const now = () => performance.now() / 1000;
  client.addEventListener("said", ({ detail: { topic, data, by } }) => topic === "eye" && gallery.hear(by, data, now()));

  return {
    refresh() {
      const told = orders(client, null);
      none.hidden = told.length > 0;
      stop.hidden = told.length === 0;
      keep(list, told, ({ robot }) => robot, () => element("li"), (item, { line }) => say(item, line));
      const looks = others(client, "");
      keep(seen, looks, entryKey, (item) => entry(client, "", item), sayLine);
      const shown = looks.filter(({ whom, state }) => state === "on" && gallery.of(whom, now()));
      keep(views, shown, ({ whom }) => whom, ({ whom }) => element("img", { alt: `What ${whom} sees` }), (image, { whom }) => {
        const { src } = gallery.of(whom, now()).image;
        if (image.src !== src) image.src = src;
      });
    },
    draw(paint, camera) {
      for (const { kind, data } of client.objects.values()) {
        if (kind !== ORDER || !data.mirror) continue;
        const [x, y, direction] = data.mirror;
        const [dx, dy] = [HALF_M * Math.cos(direction), HALF_M * Math.sin(direction)];
        paint.strokeStyle = "#4aa3df";
        paint.lineWidth = 3;
        paint.beginPath();
        paint.moveTo(...camera.toScreen([x - dx, y - dy]));
        paint.lineTo(...camera.toScreen([x + dx, y + dy]));
        paint.stroke();
      }
    },
  };
}
