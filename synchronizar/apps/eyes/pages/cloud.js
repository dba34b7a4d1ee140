/** The room's model, drawn: a square for each filled cell, coloured by its height. In the common frame, z up. */

import { BufferAttribute, BufferGeometry, Color, Group, Points, PointsMaterial } from "../../pages/vendor/three/three.module.min.js";

import { ofKind } from "../../pages/looks.js";
import { SCAN } from "./kinds.js";
import { CELL_M, middles } from "./voxels.js";

/** m, about where phones are held: colours go from that of the floor to that of the ceiling. */
const [LOWEST_M, HEIGHT_M] = [-1.5, 2.8];
/** A square covers its cell from every side. */
const LARGER = 1.5;

export class Cloud {
  #material;
  #shown = new Map();

  /** `scale`: how much smaller than the room it is drawn. */
  constructor(scale = 1) {
    this.root = new Group();
    this.#material = new PointsMaterial({ size: LARGER * CELL_M * scale, vertexColors: true });
  }

  /** Draws what has changed of the room's cubes. Who does not show it does not call this. */
  update(client) {
    const now = new Map(ofKind(client, SCAN).map((object) => [object.id, object]));
    for (const [id, { data, points }] of this.#shown) {
      if (now.get(id)?.data === data) continue;
      this.root.remove(points);
      points.geometry.dispose();
      this.#shown.delete(id);
    }
    for (const [id, { data, position }] of now) {
      if (this.#shown.has(id)) continue;
      const points = new Points(squares(middles(position, data)), this.#material);
      this.root.add(points);
      this.#shown.set(id, { data, points });
    }
  }

  dispose() {
    for (const { points } of this.#shown.values()) points.geometry.dispose();
    this.#material.dispose();
  }
}

/** Points (m) by themselves, in a material of their own. */
export function drawn(places) {
  return new Points(squares(places), new PointsMaterial({ size: CELL_M / 2, vertexColors: true }));
}

function squares(places) {
  const [geometry, colour] = [new BufferGeometry(), new Color()];
  const colours = places.flatMap(([x, y, z]) => {
    const share = Math.min(1, Math.max(0, (z - LOWEST_M) / HEIGHT_M));
    // Neighbours differ a little, so that a wall has a grain.
    const grain = 0.06 * Math.sin(40 * x + 57 * y + 71 * z);
    return colour.setHSL(0.62 - 0.5 * share, 0.4, 0.35 + 0.3 * share + grain).toArray();
  });
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(places.flat()), 3));
  geometry.setAttribute("color", new BufferAttribute(new Float32Array(colours), 3));
  return geometry;
}
