import "./resolve.js";

import assert from "node:assert/strict";
import { test } from "node:test";

import { glb } from "../../live/js/support_glb.js";

const { CELL_M, Model, SIDE, Sightings, decoded, encoded, middles, onFloor } = await import(
  "../../../synchronizar/apps/eyes/pages/voxels.js"
);
const { Stored } = await import("../../../synchronizar/apps/eyes/pages/stored.js");
const { Cloud } = await import("../../../synchronizar/apps/eyes/pages/cloud.js");
const { lookers, others } = await import("../../../synchronizar/live/pages/looks.js");
const { Scanner } = await import("../../../synchronizar/live/pages/xr/surfaces.js");
const told = JSON.parse(process.env.EYES);

/** A client whose room has these cubes, [i, j, k, cells], and a floor. */
function clientOf(cubes, floor) {
  const objects = cubes.map(([i, j, k, data]) => {
    const position = [i, j, k].map((n) => n * SIDE * CELL_M);
    return { id: `scan ${i} ${j} ${k}`, kind: "eyes scan", position, data };
  });
  if (floor !== undefined) objects.push({ id: "eyes floor", kind: "eyes floor", position: [0, 0, floor], data: null });
  return { objects: new Map(objects.map((object) => [object.id, object])) };
}

function taken(sightings) {
  const all = [];
  for (let word = sightings.take(); word; word = sightings.take()) {
    assert.ok(JSON.stringify(word).length <= 8192);
    all.push(...word);
  }
  return all;
}

const near = (a, b, within = 1e-9) => a.forEach((v, i) => assert.ok(Math.abs(v - b[i]) <= within, `${a} is not ${b}`));

test("cells are those that Python tells of the same points", () => {
  assert.equal(CELL_M, told.cell);
  assert.equal(SIDE, told.side);
  const sightings = new Sightings();
  for (const t of [0, 2]) told.points.forEach((point) => sightings.add(point, t));
  const seen = taken(sightings);
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
  sightings.add([0, 0, 0], 5);
  assert.equal(sightings.take(), null, "it is told once");
});

test("a ray meets the nearest filled cell, and the floor beside it", () => {
  const sightings = new Sightings();
  const triangle = [[2, -1, -1], [2, 1, -1], [2, 0, 1]];
  for (const t of [0, 2]) sightings.addTriangle(...triangle, t);
  const model = new Model(clientOf(taken(sightings)));
  const hit = model.hit([0, 0, 0], [1, 0, 0]);
  assert.ok(Math.abs(hit[0] - 2) < 2 * CELL_M);
  assert.equal(model.hit([0, 0, 0], [-1, 0, 0]), null);
  near(onFloor([0, 0, 1.4], [0.6, 0, -0.8], 0), [1.05, 0, 0]);
  assert.equal(onFloor([0, 0, 1.4], [1, 0, 0], 0), null);
});

test("a cell that comes later is met as well, and what is emptied is not", () => {
  const client = clientOf([]);
  const model = new Model(client);
  assert.equal(model.has([0.01, 0.01, 0.01]), false);
  const bytes = new Uint8Array(SIDE ** 3 / 8);
  bytes[0] = 1;
  const [object] = clientOf([[0, 0, 0, encoded(bytes)]]).objects.values();
  client.objects.set(object.id, object);
  assert.equal(model.has([0.01, 0.01, 0.01]), true);
  assert.equal(model.has([0.1, 0.01, 0.01]), false);
  client.objects.delete(object.id);
  assert.equal(model.has([0.01, 0.01, 0.01]), false);
});

test("the floor is the room's", () => {
  assert.equal(new Model(clientOf([])).floor, -1.4);
  assert.equal(new Model(clientOf([], -1.27)).floor, -1.27);
});

test("cells come back from their text", () => {
  const bytes = Uint8Array.from({ length: SIDE ** 3 / 8 }, (_, n) => (n === 3 ? 5 : 0));
  assert.deepEqual(decoded(encoded(bytes)), bytes);
  const expected = [8, 10].map((x) => [1 + (x + 0.5) * CELL_M, 2 + 1.5 * CELL_M, 3 + 0.5 * CELL_M]);
  middles([1, 2, 3], encoded(bytes)).forEach((p, i) => near(p, expected[i]));
});

test("a cloud is built of what is there when it is shown, and follows what changes", () => {
  const cells = (n) => encoded(Uint8Array.from({ length: SIDE ** 3 / 8 }, (_, i) => (i < n ? 255 : 0)));
  const cloud = new Cloud();
  cloud.update(clientOf([[0, 0, 0, cells(1)], [1, 0, 0, cells(2)]]));
  const counts = () => cloud.root.children.map(({ geometry }) => geometry.getAttribute("position").count).sort();
  assert.deepEqual(counts(), [16, 8]);
  const before = cloud.root.children[1];
  cloud.update(clientOf([[1, 0, 0, cells(2)]]));
  assert.deepEqual(cloud.root.children, [before]);
  cloud.update(clientOf([[1, 0, 0, cells(3)]]));
  assert.deepEqual(counts(), [24]);
});

test("a stored scan stands about its middle on the floor where it is put, turned", () => {
  // A floor of 4 m by 2 m (x by z of glTF, y up) at y = 3 with its middle at (10, 3, 0), and a mast of 1 m at its end.
  const floor = [[8, 3, -1], [12, 3, -1], [12, 3, 1], [8, 3, -1], [12, 3, 1], [8, 3, 1]];
  const mast = [[12, 3, 1], [12, 4, 1], [12, 4, 1]];
  const stored = new Stored(glb({ places: [...floor, ...mast] }));
  // x of the file goes to the right of where one looks.
  for (const [yaw, end] of [[0, [4, 0, -1]], [Math.PI / 2, [7, 1, -1]]]) {
    const cubes = [...stored.words({ position: [5, 2, -1], yaw })].flat();
    const cells = cubes.flatMap(([i, j, k, text]) => middles([i, j, k].map((n) => n * SIDE * CELL_M), text));
    const low = [0, 1, 2].map((i) => Math.min(...cells.map((p) => p[i])));
    const high = [0, 1, 2].map((i) => Math.max(...cells.map((p) => p[i])));
    const wide = yaw === 0 ? [2, 4, 1] : [4, 2, 1];
    near(high.map((v, i) => v - low[i]), wide, 2 * CELL_M);
    near([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]], [5, 2, -1], CELL_M);
    const top = cells.find((p) => p[2] > -0.2);
    near(top.slice(0, 2), end.slice(0, 2), CELL_M);
  }
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
    objects: new Map([["look 0", { kind: "look", data: { who: "", whom: "ben", state: "on" } }]]),
  };
  assert.deepEqual(others(client, "ann").map(({ whom, act }) => [whom, act]), [["ben", "ask"]]);
  assert.deepEqual(others(client, "").map(({ whom, act }) => [whom, act]), [["ann", "ask"], ["ben", "stop"]]);
  assert.match(lookers(client, "ben")[0].line, /Everybody at the room's page/);
  assert.deepEqual(lookers(client, "ann"), []);
});
