/**
 * What surrounds everybody, as filled cells in the common frame, in cubes of 16 cells a side: one bit a cell, x fastest.
 * The same as scan.py. No elements, no drawing.
 */

export const CELL_M = 0.08;
export const SIDE = 16;
const BYTES = SIDE ** 3 / 8;
const FARTHEST = 100;
/** Cubes in one word. */
const MOST_SEEN = 40;
/** s: a cell counts that was seen in two of these; what walks through is not there in both. */
const AGAIN_S = 1;
/** m: steps along a ray. */
const STEP_M = CELL_M / 2;
/** m: where the floor is, while none was seen: phones are held about so high above it. */
const UNSEEN_FLOOR_M = -1.4;
/** Cells of one layer of a cube that make a floor. */
const FLOOR_CELLS = 60;
const ONES = Array.from({ length: 256 }, (_, byte) => byte.toString(2).replaceAll("0", "").length);

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

  /** A point of a surface, m in the common frame, seen at `t` (s). */
  add(point, t) {
    const cell = point.map(cellAt);
    const cube = cell.map(cubeAt);
    if (!cube.every((n) => Math.abs(n) <= FARTHEST)) return;
    const name = cell.join(" ");
    const first = this.#seen.get(name);
    if (first === undefined) this.#seen.set(name, t);
    else if (first !== null && t - first >= AGAIN_S) {
      this.#seen.set(name, null); // it is told once
      const key = cube.join(" ");
      const bytes = this.#cubes.get(key) ?? new Uint8Array(BYTES);
      const bit = bitOf(cell);
      bytes[bit >> 3] |= 1 << (bit & 7);
      this.#cubes.set(key, bytes);
    }
  }

  /** A triangle of a surface. */
  addTriangle(a, b, c, t) {
    const longest = Math.max(...[[a, b], [b, c], [c, a]].map(([p, q]) => Math.hypot(...p.map((v, i) => v - q[i]))));
    const parts = Math.max(1, Math.ceil(longest / STEP_M));
    for (let i = 0; i <= parts; i++) {
      for (let j = 0; j <= parts - i; j++) {
        const [u, v] = [i / parts, j / parts];
        this.add(a.map((p, k) => p + u * (b[k] - p) + v * (c[k] - p)), t);
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

/** All cubes that the room has. */
export class Model {
  #cubes = new Map();

  /** A cube with its least corner (m) there has these cells, in base64. */
  set(corner, text) {
    const at = corner.map((v) => Math.round(v / (SIDE * CELL_M)));
    this.#cubes.set(at.join(" "), decoded(text));
  }

  remove(corner) {
    this.#cubes.delete(corner.map((v) => Math.round(v / (SIDE * CELL_M))).join(" "));
  }

  /** m: how high the lowest level surface is. */
  get floor() {
    let lowest = Infinity;
    for (const [key, bytes] of this.#cubes) {
      const bottom = SIDE * Number(key.split(" ")[2]);
      for (let z = 0; z < SIDE && bottom + z < lowest; z++) {
        const layer = bytes.subarray((z * SIDE * SIDE) / 8, ((z + 1) * SIDE * SIDE) / 8);
        if (layer.reduce((sum, byte) => sum + ONES[byte], 0) >= FLOOR_CELLS) lowest = bottom + z;
      }
    }
    return lowest === Infinity ? UNSEEN_FLOOR_M : (lowest + 0.5) * CELL_M;
  }

  has(point) {
    const cell = point.map(cellAt);
    const bytes = this.#cubes.get(cell.map(cubeAt).join(" "));
    const bit = bitOf(cell);
    return bytes !== undefined && (bytes[bit >> 3] & (1 << (bit & 7))) !== 0;
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
