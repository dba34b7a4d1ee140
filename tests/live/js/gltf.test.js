import assert from "node:assert/strict";
import { test } from "node:test";

import { PAGES } from "./support.js";
import { glb } from "./support_glb.js";

const { readGlb } = await import(new URL("gltf.js", PAGES));

const near = (a, b, within = 1e-6) => a.forEach((v, i) => assert.ok(Math.abs(v - b[i]) <= within, `${a} is not ${b}`));
const TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]];

function read(buffer) {
  const [triangles, points] = [[], []];
  readGlb(buffer, (...corners) => triangles.push(corners), (p) => points.push(p));
  return { triangles, points };
}

test("a triangle comes with z up, moved by its nodes", () => {
  const s = Math.SQRT1_2;
  const nodes = [{ children: [1], translation: [0, 0, 5] }, { mesh: 0, rotation: [0, s, 0, s], scale: [2, 1, 1] }];
  const [[a, b, c]] = read(glb({ places: TRIANGLE, nodes })).triangles;
  // y up: x to the right, -z ahead. A turn by 90 degrees about y takes x to -z.
  near(a, [-5, 0, 0]);
  near(b, [-3, 0, 0]);
  near(c, [-5, 0, 1]);
});

test("a node's matrix does the same as its parts", () => {
  const parts = [{ mesh: 0, translation: [1, 2, 3], rotation: [0.5, 0.5, 0.5, 0.5], scale: [1, 2, 3] }];
  const matrix = [{ mesh: 0, matrix: [0, 1, 0, 0, 0, 0, 2, 0, 3, 0, 0, 0, 1, 2, 3, 1] }];
  const [one, other] = [parts, matrix].map((nodes) => read(glb({ places: TRIANGLE, nodes })).triangles.flat());
  one.forEach((p, i) => near(p, other[i]));
});

test("triangles by indices, as a strip, as a fan, and points", () => {
  const square = [[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]];
  assert.equal(read(glb({ places: square, indices: [0, 1, 2, 2, 1, 3] })).triangles.length, 2);
  assert.equal(read(glb({ places: square, mode: 5 })).triangles.length, 2);
  assert.equal(read(glb({ places: square, mode: 6 })).triangles.length, 2);
  assert.equal(read(glb({ places: square, mode: 0 })).points.length, 4);
  near(read(glb({ places: square, indices: [0, 1, 2, 2, 1, 3] })).triangles[1][2], [-1, -1, 0]);
});

test("numbers that lie between others are read by their stride", () => {
  near(read(glb({ places: TRIANGLE, stride: 20 })).triangles[0][1], [0, -1, 0]);
});

test("what cannot be read is refused in a sentence", () => {
  for (const [buffer, why] of [
    [new ArrayBuffer(0), /no binary glTF/],
    [new TextEncoder().encode("this is no scan, but some text of a hundred letters").buffer, /no binary glTF/],
    [glb({ places: TRIANGLE, required: ["KHR_draco_mesh_compression"] }), /KHR_draco_mesh_compression/],
    [glb({ places: TRIANGLE, nodes: [{ mesh: 3 }] }), /damaged/],
    [glb({ places: TRIANGLE, nodes: [{ children: [0] }] }), /damaged/],
    [glb({ places: TRIANGLE }).slice(0, -8), /damaged/],
    [glb({ places: TRIANGLE, indices: [0, 1, 9] }), /damaged/],
    [glb({ places: TRIANGLE, nodes: [{}] }), /no surfaces/],
    [glb({ places: TRIANGLE, uri: "scan.bin" }), /another file/],
  ]) {
    assert.throws(() => read(buffer), (error) => why.test(error.message) && error.message.startsWith("The file cannot be read"));
  }
  assert.equal(read(glb({ places: TRIANGLE, required: ["KHR_materials_unlit"] })).triangles.length, 1);
});
