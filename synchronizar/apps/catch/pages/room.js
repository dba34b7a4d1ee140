/** Catch on the room's page: the ball and its arc from above, who has caught how often. */

import { element, keep, say } from "../../pages/dom.js";
import { Sound } from "../../pages/sound.js";
import { BALL, SCORE, arc, flown, handOf, words } from "./ball.js";
import { soundOf } from "./sounds.js";

const RADIUS = 7;

/** `place`: what the room's page has, see docs/apps.md. */
export function begin({ client, panel, model }) {
  const sound = new Sound();
  const line = element("p", { role: "status" });
  const score = element("p", { class: "app-score" });
  const list = element("ol", { class: "app-list" });
  panel.append(element("h2", { text: "Catch" }), score, line, list, sound.button());
  let before = "";

  return {
    /** A few times a second: the words. */
    refresh() {
      const [ball, told] = [client.objects.get(BALL), client.objects.get(SCORE)];
      const { rally, best, line: text } = words(told, ball, null);
      say(score, `Rally ${rally} · Best ${best}`);
      say(line, text);
      const caught = Object.entries(told?.data.caught ?? {}).sort(([, a], [, b]) => b - a);
      keep(list, caught, ([name]) => name, () => element("li"), (item, [name, n]) => say(item, `${name}: ${n}`));
      const phase = ball?.data.phase ?? "";
      const heard = soundOf(before, phase);
      if (phase !== before && before && heard) sound.play(heard);
      before = phase;
    },

    /** With each frame, above all else: the ball. */
    draw(paint, camera) {
      const [ball, told] = [client.objects.get(BALL), client.objects.get(SCORE)];
      const t = client.roomTime;
      if (!ball || t === null) return;
      const at = placeOf(ball, t, model);
      if (ball.data.phase === "flies" && told) {
        paint.strokeStyle = "#f58a1f";
        paint.setLineDash([3, 5]);
        paint.lineWidth = 2;
        paint.beginPath();
        arc(ball.data, t, told.data.floor).forEach((point, i) => {
          const [x, y] = camera.toScreen(point);
          if (i) paint.lineTo(x, y);
          else paint.moveTo(x, y);
        });
        paint.stroke();
        paint.setLineDash([]);
      }
      const [x, y] = camera.toScreen(at);
      // The higher it flies, the larger it looks from above.
      const height = ball.data.phase === "flies" && told ? at[2] - told.data.floor : 1;
      paint.beginPath();
      paint.arc(x, y, RADIUS * Math.min(2, Math.max(0.7, 0.7 + 0.3 * height)), 0, 2 * Math.PI);
      paint.fillStyle = "#f58a1f";
      paint.fill();
      paint.lineWidth = 2;
      paint.strokeStyle = "#7a3d00";
      paint.stroke();
    },
  };
}

function placeOf({ position, data }, t, model) {
  if (data.phase === "flies") return flown(data, t);
  const user = data.phase === "held" ? model.users.get(data.by) : null;
  if (!user?.pose?.quat_xyzw) return position;
  const { x, y, z, quat_xyzw } = user.pose;
  return handOf([x, y, z], quat_xyzw, user.up);
}
