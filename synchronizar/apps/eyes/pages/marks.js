/** What was pointed at: a pin and the name of who did. In the common frame, z up. */

import { ConeGeometry, Group, Mesh, MeshStandardMaterial } from "../../pages/vendor/three/three.module.min.js";

import { ofKind } from "../../pages/looks.js";
import { colourOf } from "../../pages/view/colours.js";
import { dispose, label } from "../../pages/xr/label.js";
import { MARK } from "./kinds.js";

/** Its tip is at the place. */
const PIN = new ConeGeometry(0.05, 0.2, 20).rotateX(-Math.PI / 2).translate(0, 0, 0.1);

export class Marks {
  #shown = new Map();

  constructor() {
    this.root = new Group();
  }

  /** Where each is drawn, by its id; for tests. */
  get places() {
    return Object.fromEntries([...this.#shown].map(([id, { pin }]) => [id, [pin.position.x, pin.position.y, pin.position.z + this.root.position.z]]));
  }

  update(client) {
    const now = new Map(ofKind(client, MARK).map((object) => [object.id, object]));
    for (const [id, { pin, tag }] of this.#shown) {
      if (now.has(id)) continue;
      this.root.remove(pin);
      pin.material.dispose();
      dispose(tag);
      this.#shown.delete(id);
    }
    for (const [id, { position, data }] of now) {
      if (this.#shown.has(id)) continue;
      const colour = colourOf(client.member(data.by)?.index ?? 6, true);
      const pin = new Mesh(PIN, new MeshStandardMaterial({ color: colour, roughness: 0.5 }));
      const tag = label(data.by || "room's page", colour);
      tag.position.set(0, 0, 0.3);
      pin.position.set(...position);
      pin.add(tag);
      this.root.add(pin);
      this.#shown.set(id, { pin, tag });
    }
  }
}
