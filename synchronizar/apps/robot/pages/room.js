/** Robots on the room's page: what each does, and where its mirror stands. */

import { element, keep, say } from "../../pages/dom.js";
import { ORDER, orders } from "./orders.js";

const HALF_M = 1.5;

/** `place`: what the room's page has, see docs/apps.md. */
export function begin({ client, panel }) {
  const list = element("ul", { class: "app-list" });
  const none = element("p", { class: "quiet", text: "No robot is here yet." });
  const stop = element("button", { type: "button", text: "Stop all robots" });
  stop.addEventListener("click", () => client.say("stay", {}, "app"));
  panel.append(element("h2", { text: "Robots" }), none, list, stop);

  return {
    refresh() {
      const told = orders(client, null);
      none.hidden = told.length > 0;
      stop.hidden = told.length === 0;
      keep(list, told, ({ robot }) => robot, () => element("li"), (item, { line }) => say(item, line));
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
