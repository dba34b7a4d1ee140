/** A stored scan on its way into the room's model: it lies where one looks until it is put down, as cells like any other. */

import { readGlb } from "../../pages/gltf.js";
import { Floor } from "../../pages/xr/floor.js";
import { Sightings } from "./voxels.js";

/** Points that are shown while it is being placed. */
const MOST_SHOWN = 20000;

export class Stored {
  #triangles = [];
  #points = [];
  #middle;

  /** Of a .glb file. Throws Error with a sentence for people. */
  constructor(buffer) {
    readGlb(buffer, (...corners) => this.#triangles.push(corners), (p) => this.#points.push(p));
    const floor = new Floor();
    const all = this.#all();
    const [low, high] = [Math.min, Math.max].map((of) => [0, 1, 2].map((i) => all.reduce((v, p) => of(v, p[i]), all[0][i])));
    for (const [, , z] of all) floor.add(z, Infinity);
    // It stands on its floor, about its middle.
    this.#middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, floor.height ?? low[2]];
  }

  /** Some of its points (m) where it stands at `at` {position, yaw}, to be drawn. */
  shown(at) {
    const all = this.#all();
    const every = Math.ceil(all.length / MOST_SHOWN);
    return all.filter((_, n) => n % every === 0).map((p) => this.#put(p, at));
  }

  /** Data of words `seen`, one after another. */
  *words(at) {
    const sightings = new Sightings();
    for (const corners of this.#triangles) sightings.addTriangle(...corners.map((p) => this.#put(p, at)), 0, true);
    for (const p of this.#points) sightings.add(this.#put(p, at), 0, true);
    for (let word = sightings.take(); word; word = sightings.take()) yield word;
  }

  /** Corners, and middles of what is large. */
  #all() {
    const middles = this.#triangles.map((corners) => [0, 1, 2].map((i) => (corners[0][i] + corners[1][i] + corners[2][i]) / 3));
    return [...this.#triangles.flat(), ...middles, ...this.#points];
  }

  #put(p, { position, yaw }) {
    const [x, y, z] = p.map((v, i) => v - this.#middle[i]);
    const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
    return [position[0] + c * x - s * y, position[1] + s * x + c * y, position[2] + z];
  }
}
