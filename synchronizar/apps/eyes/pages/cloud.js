/** The room's model, drawn: a square for each filled cell, coloured by its height. In the common frame, z up. */

import { BufferAttribute, BufferGeometry, Color, Group, Points, PointsMaterial } from "../../pages/vendor/three/three.module.min.js";

import { ofKind } from "../../pages/looks.js";
import { SCAN } from "./kinds.js";
import { CELL_M, middles } from "./voxels.js";

/** m, about where phones are held: colours go from that of the floor to that of the ceiling. */
const [LOWEST_M, HEIGHT_M] = [-1.5, 2.8];
/** A square covers its cell from every side. */
const LARGER = 1.5;
/** Cubes that are built anew with one frame: the page has other things to do. */
const MOST_A_FRAME = 3;

export class Cloud {
  #material;
  #shown = new Map();

  /** `scale`: how much smaller than the room it is drawn. */
  constructor(scale = 1) {
    this.root = new Group();
    this.#material = new PointsMaterial({ size: LARGER * CELL_M * scale, vertexColors: true });
  }

  /** Draws what has changed of the room's cubes, some with each frame. Who does not show it does not call this. */
  update(client) {
    const now = new Map(ofKind(client, SCAN).map((object) => [object.id, object]));
    for (const id of this.#shown.keys()) if (!now.has(id)) this.#drop(id);
    let left = MOST_A_FRAME;
    for (const [id, { data, position }] of now) {
      if (this.#shown.get(id)?.data === data) continue;
      if (left-- === 0) return;
      this.#drop(id);
      const points = new Points(squares(middles(position, data)), this.#material);
      this.root.add(points);
      this.#shown.set(id, { data, points });
    }
  }

  #drop(id) {
    const shown = this.#shown.get(id);
    if (!shown) return;
    this.root.remove(shown.points);
    shown.points.geometry.dispose();
    this.#shown.delete(id);
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
  const [at, colours] = [new Float32Array(3 * places.length), new Float32Array(3 * places.length)];
  places.forEach(([x, y, z], n) => {
    const share = Math.min(1, Math.max(0, (z - LOWEST_M) / HEIGHT_M));
    // Neighbours differ a little, so that a wall has a grain.
    const grain = 0.06 * Math.sin(40 * x + 57 * y + 71 * z);
    at.set([x, y, z], 3 * n);
    colour.setHSL(0.62 - 0.5 * share, 0.4, 0.35 + 0.3 * share + grain).toArray(colours, 3 * n);
  });
  geometry.setAttribute("position", new BufferAttribute(at, 3));
  geometry.setAttribute("color", new BufferAttribute(colours, 3));
  return geometry;
}
