/**
 * What surrounds everybody, as filled cells in the common frame, in cubes of 16 cells a side: one bit a cell, x fastest.
 * The same as scan.py. No elements, no drawing.
 */

import { ofKind } from "../../pages/looks.js";
import { FLOOR } from "./kinds.js";

export const CELL_M = 0.08;
export const SIDE = 16;
const BYTES = SIDE ** 3 / 8;
const FARTHEST = 100;
/** Cubes in one word, which has 8 kB at most. */
const MOST_SEEN = 11;
/** s: a cell counts that was seen in two of these; what walks through is not there in both. */
const AGAIN_S = 1;
/** m: steps along a ray. */
const STEP_M = CELL_M / 2;
/** m: where the floor is, while none was seen: phones are held about so high above it. */
const UNSEEN_FLOOR_M = -1.4;

const cellAt = (v) => Math.floor(v / CELL_M);
const cubeAt = (cell) => Math.floor(cell / SIDE);
const within = (cell) => ((cell % SIDE) + SIDE) % SIDE;
const bitOf = ([x, y, z]) => within(x) + SIDE * (within(y) + SIDE * within(z));

/** Cells in base64, as bytes. */
export function decoded(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

/** Cells in base64. */
export function encoded(bytes) {
  return btoa(String.fromCharCode(...bytes));
}

/** What somebody sees, gathered until it is told. */
export class Sightings {
  #seen = new Map();
  #cubes = new Map();

  /** A point of a surface, m in the common frame, seen at `t` (s). `again`: it counts as seen twice. */
  add(point, t, again = false) {
    const cell = point.map(cellAt);
    const cube = cell.map(cubeAt);
    if (!cube.every((n) => Math.abs(n) <= FARTHEST)) return;
    const name = cell.join(" ");
    const first = this.#seen.get(name);
    if (first === undefined && !again) this.#seen.set(name, t);
    else if (first !== null && (again || t - first >= AGAIN_S)) {
      this.#seen.set(name, null); // it is told once
      const key = cube.join(" ");
      const bytes = this.#cubes.get(key) ?? new Uint8Array(BYTES);
      const bit = bitOf(cell);
      bytes[bit >> 3] |= 1 << (bit & 7);
      this.#cubes.set(key, bytes);
    }
  }

  /** A triangle of a surface. */
  addTriangle(a, b, c, t, again = false) {
    const longest = Math.max(...[[a, b], [b, c], [c, a]].map(([p, q]) => Math.hypot(...p.map((v, i) => v - q[i]))));
    const parts = Math.max(1, Math.ceil(longest / STEP_M));
    for (let i = 0; i <= parts; i++) {
      for (let j = 0; j <= parts - i; j++) {
        const [u, v] = [i / parts, j / parts];
        this.add(a.map((p, k) => p + u * (b[k] - p) + v * (c[k] - p)), t, again);
      }
    }
  }

  /** The data of a word `seen`: what was not told yet, or null. */
  take() {
    const entries = [...this.#cubes].slice(0, MOST_SEEN);
    if (!entries.length) return null;
    for (const [key] of entries) this.#cubes.delete(key);
    return entries.map(([key, bytes]) => [...key.split(" ").map(Number), encoded(bytes)]);
  }

  /** Where the device is has changed: what it saw from there is nothing. */
  clear() {
    this.#seen.clear();
    this.#cubes.clear();
  }
}

/** All cubes that the room has, as somebody points at them; each is read once a ray comes to it. */
export class Model {
  #client;
  #read = new Map();

  constructor(client) {
    this.#client = client;
  }

  /** m, common frame: how high the floor is by whom it was seen first. */
  get floor() {
    return ofKind(this.#client, FLOOR)[0]?.position[2] ?? UNSEEN_FLOOR_M;
  }

  has(point) {
    const cell = point.map(cellAt);
    const bytes = this.#cells(`scan ${cell.map(cubeAt).join(" ")}`);
    const bit = bitOf(cell);
    return bytes !== null && (bytes[bit >> 3] & (1 << (bit & 7))) !== 0;
  }

  #cells(id) {
    const data = this.#client.objects.get(id)?.data;
    if (typeof data !== "string") return null;
    if (this.#read.get(id)?.data !== data) this.#read.set(id, { data, bytes: decoded(data) });
    return this.#read.get(id).bytes;
  }

  /** Where a ray (origin m, way of length 1) first meets something within `reach` m; null where it does not. */
  hit(origin, way, reach = 12) {
    for (let along = 0; along <= reach; along += STEP_M) {
      const point = origin.map((v, i) => v + along * way[i]);
      if (this.has(point)) return point;
    }
    return null;
  }
}

/** The middles (m) of the filled cells of a cube, from its least corner. */
export function middles(corner, text) {
  const out = [];
  decoded(text).forEach((byte, n) => {
    for (let b = 0; byte >> b; b++) {
      if (!((byte >> b) & 1)) continue;
      const bit = 8 * n + b;
      const cell = [bit % SIDE, Math.floor(bit / SIDE) % SIDE, Math.floor(bit / SIDE ** 2)];
      out.push(cell.map((v, i) => corner[i] + (v + 0.5) * CELL_M));
    }
  });
  return out;
}

/** Where a ray meets the floor (z of it, m) within `reach` m; null where it does not. */
export function onFloor(origin, way, floor, reach = 12) {
  if (way[2] >= -0.05) return null;
  const along = (floor - origin[2]) / way[2];
  return along > 0 && along <= reach ? origin.map((v, i) => v + along * way[i]) : null;
}
