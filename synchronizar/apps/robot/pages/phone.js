/** Robots on a phone: buttons for orders, and the mirror as a line on the floor. */

import {
  DoubleSide,
  Mesh,
  MeshBasicMaterial,
  PlaneGeometry,
} from "../../pages/vendor/three/three.module.min.js";

import { element, keep, say } from "../../pages/dom.js";
import { LOOK } from "../../pages/looks.js";
import { Looking } from "../../pages/xr/looking.js";
import { ORDER, orders } from "./orders.js";

const MIRROR_M = [3, 2];

/** `place`: what the phone's page has, see docs/apps.md. */
export function begin(place) {
  const { client, name, common, panel, registered } = place;
  const looking = new Looking(place);
  const list = element("ul", { class: "app-list" });
  const buttons = element("div", { class: "app-row" });
  for (const [text, order] of [["Mirror me", "mirror"], ["Come", "come"], ["Stay", "stay"]]) {
    const button = element("button", { type: "button", text });
    button.addEventListener("click", () => client.say(order, {}, "app"));
    buttons.append(button);
  }
  panel.append(list, buttons);
  const glass = new Mesh(
    new PlaneGeometry(...MIRROR_M).rotateX(Math.PI / 2),
    new MeshBasicMaterial({ color: 0x9fd3ff, transparent: true, opacity: 0.18, side: DoubleSide, depthWrite: false }),
  );
  glass.visible = false;
  common.add(glass);

  return {
    kinds: new Set([ORDER, LOOK]),
    /** Where screens are drawn, in the common frame; for tests. */
    get places() {
      return looking.places;
    },
    update(dt) {
      looking.update(dt);
      const told = orders(client, name);
      buttons.hidden = !registered() || !told.some(({ here }) => here);
      const lines = told.length ? told : [{ robot: "", line: "No robot is here yet." }];
      keep(list, lines, ({ robot }) => robot, () => element("li"), (item, { line }) => say(item, line));
      const mirrored = [...client.objects.values()].find(({ kind, data }) => kind === ORDER && data.mirror);
      glass.visible = mirrored !== undefined;
      if (!mirrored) return;
      const [x, y, direction] = mirrored.data.mirror;
      glass.position.set(x, y, 0);
      glass.rotation.set(0, 0, direction);
    },
    end() {
      looking.end();
      common.remove(glass);
      panel.replaceChildren();
    },
  };
}
