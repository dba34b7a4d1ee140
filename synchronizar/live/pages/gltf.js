/**
 * Surfaces of a stored scan: a binary glTF 2.0 file (.glb) as triangles and points, in m and axes with z up. Its colours,
 * bones and movements are left out; what is compressed is not read.
 */

import { zUpFromYUp } from "./axes.js";

const [MAGIC, JSON_CHUNK, BIN_CHUNK] = [0x46546c67, 0x4e4f534a, 0x004e4942];
const ARRAYS = { 5121: Uint8Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };
const WIDTHS = { SCALAR: 1, VEC3: 3 };
const [POINTS, TRIANGLES, STRIP, FAN] = [0, 4, 5, 6];
const MOST_CORNERS = 3e6;
/** Extensions that do not change where surfaces are. */
const HARMLESS = /^(KHR_materials_|KHR_texture_|EXT_texture_)/;

/** Calls `triangle(a, b, c)` and `point(p)`. Throws Error with a sentence for people. */
export function readGlb(buffer, triangle, point) {
  try {
    read(buffer, triangle, point);
  } catch (error) {
    if (error instanceof Unreadable) throw error;
    throw new Unreadable("it is damaged.", { cause: error });
  }
}

class Unreadable extends Error {
  constructor(why, options) {
    super(`The file cannot be read: ${why}`, options);
  }
}

function read(buffer, triangle, point) {
  const [gltf, body] = chunks(buffer);
  const odd = (gltf.extensionsRequired ?? []).filter((name) => !HARMLESS.test(name));
  if (odd.length) throw new Unreadable(`it needs ${odd.join(", ")}. Save it without compression.`);
  let corners = 0;
  for (const [mesh, matrix] of placed(gltf)) {
    for (const { mode = TRIANGLES, attributes, indices } of gltf.meshes[mesh].primitives) {
      const places = values(gltf, body, attributes.POSITION);
      const order = indices === undefined ? null : values(gltf, body, indices);
      const count = order?.length ?? places.length / 3;
      corners += count;
      if (corners > MOST_CORNERS) throw new Unreadable(`it has more than ${MOST_CORNERS / 3e6} million triangles.`);
      const at = (n) => {
        const first = 3 * (order ? order[n] : n);
        const place = zUpFromYUp(moved(matrix, places.subarray(first, first + 3)));
        if (!place.every(Number.isFinite)) throw new Error("a corner that is nowhere");
        return place;
      };
      if (mode === POINTS) for (let n = 0; n < count; n++) point(at(n));
      else if (mode === TRIANGLES) for (let n = 0; n + 2 < count; n += 3) triangle(at(n), at(n + 1), at(n + 2));
      else if (mode === STRIP) for (let n = 0; n + 2 < count; n++) triangle(at(n), at(n + 1), at(n + 2));
      else if (mode === FAN) for (let n = 1; n + 1 < count; n++) triangle(at(0), at(n), at(n + 1));
    }
  }
  if (!corners) throw new Unreadable("it has no surfaces.");
}

/** What the file says, and its numbers. */
function chunks(buffer) {
  const view = new DataView(buffer);
  const fits = buffer.byteLength >= 20 && view.getUint32(0, true) === MAGIC && view.getUint32(4, true) === 2;
  if (!fits || view.getUint32(16, true) !== JSON_CHUNK) throw new Unreadable("it is no binary glTF 2.0 (.glb).");
  const length = view.getUint32(12, true);
  const gltf = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, length)));
  const next = 20 + length;
  const has = next + 8 <= buffer.byteLength && view.getUint32(next + 4, true) === BIN_CHUNK;
  return [gltf, has ? buffer.slice(next + 8, next + 8 + view.getUint32(next, true)) : new ArrayBuffer(0)];
}

/** [mesh, matrix] of all that stand in its scene. */
function placed(gltf) {
  const out = [];
  const visit = (number, above, depth) => {
    if (depth > gltf.nodes.length) throw new Error("a node within itself");
    const node = gltf.nodes[number];
    const matrix = multiply(above, node.matrix ?? composed(node));
    if (node.mesh !== undefined) out.push([node.mesh, matrix]);
    for (const child of node.children ?? []) visit(child, matrix, depth + 1);
  };
  const one = composed({});
  for (const root of gltf.scenes?.[gltf.scene ?? 0]?.nodes ?? []) visit(root, one, 0);
  return out;
}

/** 16 numbers, column by column. */
function composed({ translation: t = [0, 0, 0], rotation: [x, y, z, w] = [0, 0, 0, 1], scale: s = [1, 1, 1] }) {
  return [
    ...[1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)].map((v) => v * s[0]), 0,
    ...[2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)].map((v) => v * s[1]), 0,
    ...[2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)].map((v) => v * s[2]), 0,
    ...t, 1,
  ];
}

function multiply(a, b) {
  return b.map((_, n) => [0, 1, 2, 3].reduce((sum, k) => sum + a[4 * k + (n % 4)] * b[4 * (n >> 2) + k], 0));
}

function moved(m, [x, y, z]) {
  return [0, 1, 2].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]);
}

/** All numbers of an accessor, one after another. */
function values(gltf, body, number) {
  const { bufferView, byteOffset = 0, componentType, count, type, sparse } = gltf.accessors[number];
  const [Kind, width] = [ARRAYS[componentType], WIDTHS[type]];
  if (!Kind || !width || sparse || bufferView === undefined) throw new Unreadable("its places are stored in a way that is not known here.");
  const { buffer = 0, byteOffset: begin = 0, byteStride } = gltf.bufferViews[bufferView];
  if (buffer !== 0 || gltf.buffers?.[0]?.uri !== undefined) throw new Unreadable("its numbers are in another file. Save all of it as one.");
  const size = width * Kind.BYTES_PER_ELEMENT;
  const out = new Kind(count * width);
  const bytes = new Uint8Array(out.buffer);
  for (let i = 0; i < count; i++) {
    const from = begin + byteOffset + i * (byteStride ?? size);
    if (from + size > body.byteLength) throw new Error("it ends too early");
    bytes.set(new Uint8Array(body, from, size), i * size);
  }
  return out;
}
