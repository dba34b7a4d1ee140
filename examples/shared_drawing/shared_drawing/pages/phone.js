/** Drawing on a phone: while the screen is held, a line follows the point in front of the phone. */

import { BufferGeometry, Float32BufferAttribute, Line, LineBasicMaterial } from "../../pages/vendor/three/three.module.min.js";

import { commonFromDevice, turned } from "../../pages/axes.js";
import { colourOf } from "../../pages/view/colours.js";

const STROKE = "drawing stroke";
const AHEAD_M = 0.3;
const STEP_M = 0.02;

export function begin({ client, common, frame, own, panel }) {
  const shown = new Map();
  let stroke = null;
  const wipe = Object.assign(document.createElement("button"), { type: "button", textContent: "Wipe mine off" });
  wipe.addEventListener("click", () => client.say("wipe", null, "app"));
  panel.append(wipe);

  function tip() {
    const [here, placing] = [own(), frame.placing];
    if (!here || !placing) return null;
    const ahead = turned(here.quat_xyzw, [0, 0, -AHEAD_M]);
    return commonFromDevice(placing, here.position.map((v, i) => v + ahead[i]));
  }

  function draw(id, { by, points }) {
    const line = shown.get(id) ?? new Line(new BufferGeometry(), new LineBasicMaterial({ color: colourOf(client.member(by)?.index ?? 6, true) }));
    if (line.userData.n === points.length) return;
    line.userData.n = points.length;
    line.geometry.dispose();
    line.geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(points.flat(), 3));
    shown.set(id, line);
    common.add(line);
  }

  return {
    kinds: new Set([STROKE]),
    select: { start: () => (stroke = { id: Math.floor(performance.now()), last: null }), end: () => (stroke = null) },
    update() {
      const at = stroke && tip();
      if (at && (!stroke.last || Math.hypot(...at.map((v, i) => v - stroke.last[i])) > STEP_M)) {
        client.say("stroke", { id: stroke.id, points: [at] }, "app");
        stroke.last = at;
      }
      for (const { id, kind, data } of client.objects.values()) if (kind === STROKE) draw(id, data);
      for (const [id, line] of shown) if (!client.objects.has(id)) common.remove(line), shown.delete(id);
    },
    end: () => shown.forEach((line) => common.remove(line)),
  };
}
