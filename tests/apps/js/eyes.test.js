import "./resolve.js";

import assert from "node:assert/strict";
import { test } from "node:test";

const { CELL_M, Model, SIDE, Sightings, decoded, encoded, middles, onFloor } = await import(
  "../../../synchronizar/apps/eyes/pages/voxels.js"
);
const { lookers, others } = await import("../../../synchronizar/apps/eyes/pages/looks.js");
const { Scanner } = await import("../../../synchronizar/apps/eyes/pages/scanner.js");
const told = JSON.parse(process.env.EYES);

const near = (a, b, within = 1e-9) => a.forEach((v, i) => assert.ok(Math.abs(v - b[i]) <= within, `${a} is not ${b}`));

test("cells are those that Python tells of the same points", () => {
  assert.equal(CELL_M, told.cell);
  assert.equal(SIDE, told.side);
  const sightings = new Sightings();
  for (const t of [0, 2]) told.points.forEach((point) => sightings.add(point, t));
  const seen = sightings.take();
  for (let more = sightings.take(); more; more = sightings.take()) seen.push(...more);
  const sorted = (cubes) => [...cubes].sort((a, b) => (String(a) < String(b) ? -1 : 1));
  assert.deepEqual(sorted(seen), sorted(told.seen));
});

test("what was seen in one moment only is not told: it may have walked through", () => {
  const sightings = new Sightings();
  sightings.add([0, 0, 0], 0);
  sightings.add([0, 0, 0], 0.5);
  assert.equal(sightings.take(), null);
  sightings.add([0, 0, 0], 1.1);
  assert.equal(sightings.take().length, 1);
});

test("a ray meets the nearest filled cell, and the floor beside it", () => {
  const model = new Model();
  const sightings = new Sightings();
  const triangle = [[2, -1, -1], [2, 1, -1], [2, 0, 1]];
  for (const t of [0, 2]) sightings.addTriangle(...triangle, t);
  for (const [i, j, k, cells] of sightings.take()) model.set([i, j, k].map((n) => n * SIDE * CELL_M), cells);
  const hit = model.hit([0, 0, 0], [1, 0, 0]);
  assert.ok(Math.abs(hit[0] - 2) < 2 * CELL_M);
  assert.equal(model.hit([0, 0, 0], [-1, 0, 0]), null);
  near(onFloor([0, 0, 1.4], [0.6, 0, -0.8], 0), [1.05, 0, 0]);
  assert.equal(onFloor([0, 0, 1.4], [1, 0, 0], 0), null);
});

test("the floor is the lowest level surface, not the lowest cell", () => {
  const model = new Model();
  assert.equal(model.floor, -1.4);
  const bytes = new Uint8Array(SIDE ** 3 / 8);
  bytes[0] = 1; // one cell at the bottom
  bytes.fill(255, (3 * SIDE * SIDE) / 8, (4 * SIDE * SIDE) / 8);
  model.set([0, 0, -SIDE * CELL_M], encoded(bytes));
  assert.ok(Math.abs(model.floor - (-SIDE + 3.5) * CELL_M) < 1e-9);
  assert.equal(middles([0, 0, 0], encoded(bytes)).length, 1 + SIDE * SIDE);
  assert.deepEqual(decoded(encoded(bytes)), bytes);
});

test("depth becomes points where the view looks, and a stretch without depth none", () => {
  const scanner = new Scanner();
  const identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 2, 3, 1];
  const view = { projectionMatrix: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, -1, 0, 0, 0, 0], transform: { matrix: identity } };
  const frame = {
    session: { enabledFeatures: ["depth-sensing"] },
    getViewerPose: () => ({ views: [view] }),
    getDepthInformation: () => ({ getDepthInMeters: (u) => (u < 0.5 ? 2 : 0) }),
  };
  const points = [];
  scanner.scan(frame, {}, 1000, (point) => points.push(point), () => assert.fail());
  assert.equal(points.length, (24 * 24) / 2);
  assert.ok(points.every(([x, , z]) => x < 1 && Math.abs(z - 1) < 1e-9));
  scanner.scan(frame, {}, 1100, () => assert.fail("too soon"));
});

test("everybody reads who sees what", () => {
  const member = (name, index, more = {}) => [index, { name, index, here: true, static: false, ...more }];
  const client = {
    members: new Map([member("ann", 0), member("ben", 1), member("cem", 2, { here: false }), member("shelf", 3, { static: true })]),
    objects: new Map([["look 0", { kind: "eyes look", data: { who: "", whom: "ben", state: "on" } }]]),
  };
  assert.deepEqual(others(client, "ann").map(({ whom, act }) => [whom, act]), [["ben", "ask"]]);
  assert.deepEqual(others(client, "").map(({ whom, act }) => [whom, act]), [["ann", "ask"], ["ben", "stop"]]);
  assert.match(lookers(client, "ben")[0].line, /Everybody at the room's page/);
  assert.deepEqual(lookers(client, "ann"), []);
});
