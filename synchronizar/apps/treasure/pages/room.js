/** Treasure on the room's page: what lies where, who has how many, who was best. */

import { element, keep, say, swatch } from "../../pages/dom.js";
import { COLOURS, GHOST, NAMES, THING, ghostAt, ofKind, scoreOf, standing, words } from "./model.js";

const RADIUS = 6;
/** As on the map; what has none is round. */
const SHAPES = { obstacle: "M8 1l7 14H1z", start: "M8 0a8 8 0 1 0 0 16A8 8 0 0 0 8 0zm0 2a6 6 0 1 1 0 12A6 6 0 0 1 8 2z" };

/** `place`: what the room's page has, see docs/apps.md. */
export function begin({ client, panel }) {
  const head = element("p", { class: "app-score" });
  const line = element("p", { role: "status" });
  const players = element("ol", { class: "app-list" });
  const title = element("h3", { text: "Best until now" });
  const best = element("ol", { class: "app-list" });
  const legend = element("ul", { class: "app-legend" });
  for (const [what, name] of Object.entries(NAMES)) legend.append(element("li", {}, swatch(COLOURS[what], SHAPES[what]), name));
  panel.append(element("h2", { text: "Treasure" }), head, line, players, title, best, legend);

  return {
    refresh() {
      const score = scoreOf(client);
      const told = words(score, null);
      say(head, told.head);
      say(line, told.line);
      const item = () => element("li");
      keep(players, standing(score), ([name]) => name, item, (row, [name, coins]) => say(row, `${name}: ${coins}`));
      const walks = score?.best ?? [];
      title.hidden = walks.length === 0;
      keep(best, walks.map((walk, n) => [n, ...walk]), ([n]) => n, item, (row, [, name, coins, seconds]) =>
        say(row, `${name}: ${coins} in ${Math.round(seconds)} s`),
      );
    },
    draw(paint, camera) {
      for (const { position, data } of ofKind(client, THING)) {
        const [x, y] = camera.toScreen(position);
        paint.fillStyle = COLOURS[data.what];
        paint.strokeStyle = "#2b2118";
        paint.lineWidth = 1.5;
        paint.beginPath();
        if (data.what === "obstacle") {
          paint.moveTo(x, y - RADIUS);
          paint.lineTo(x + RADIUS, y + RADIUS);
          paint.lineTo(x - RADIUS, y + RADIUS);
          paint.closePath();
        } else {
          paint.arc(x, y, data.what === "start" ? 2 * RADIUS : RADIUS, 0, 2 * Math.PI);
        }
        if (data.what !== "start") paint.fill();
        paint.stroke();
      }
      const t = client.roomTime;
      for (const { data } of t === null ? [] : ofKind(client, GHOST)) {
        const at = ghostAt(data, t);
        if (!at) continue;
        const [x, y] = camera.toScreen(at);
        paint.globalAlpha = 0.5;
        paint.beginPath();
        paint.arc(x, y, RADIUS, 0, 2 * Math.PI);
        paint.fillStyle = "#8a94a0";
        paint.fill();
        paint.globalAlpha = 1;
      }
    },
  };
}
