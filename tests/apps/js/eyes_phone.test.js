import "./resolve.js";

import assert from "node:assert/strict";
import { test } from "node:test";

/** As much of a page as its lists and buttons need. */
class Element extends EventTarget {
  children = [];
  dataset = {};
  setAttribute() {}
  append(...made) {
    this.children.push(...made);
  }
  replaceChildren() {
    this.children = [];
  }
  get firstChild() {
    return this.children[0] ?? null;
  }
}
globalThis.document = { createElement: () => new Element() };

const { begin } = await import("../../../synchronizar/apps/eyes/pages/phone.js");
const { CELL_M, SIDE, middles } = await import("../../../synchronizar/apps/eyes/pages/voxels.js");

/** A phone 1.4 m above its floor that looks straight down, its frame `sigma` well known, `z` above the common one. */
function phone({ sigma = 0.1, z = 0 } = {}) {
  const said = [];
  const pose = { position: [0, 0, 0], quat_xyzw: [0, 0, 0, 1] };
  const client = Object.assign(new EventTarget(), {
    objects: new Map(),
    members: new Map(),
    say: (topic, data) => said.push([topic, data]),
  });
  const layer = begin({
    client,
    name: "ann",
    common: { add: () => {}, remove: () => {} },
    panel: new Element(),
    avatars: { placeOf: () => null },
    frame: { placing: { x: 0, y: 0, z, yaw: 0, scale: 1 }, told: { sigma } },
    own: () => pose,
    registered: () => true,
    picture: {},
  });
  // The view's -z is down, its y ahead.
  const down = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1];
  const view = { projectionMatrix: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, -1, 0, 0, 0, 0], transform: { matrix: down } };
  const seen = {
    session: { enabledFeatures: ["depth-sensing"] },
    getViewerPose: () => ({ views: [view] }),
    getDepthInformation: () => ({ getDepthInMeters: () => 1.4 }),
  };
  const floor = (height) =>
    client.objects.set("eyes floor", { id: "eyes floor", kind: "eyes floor", position: [0, 0, height], data: null });
  /** Looks until what it sees counts, and tells. */
  function look() {
    for (let t = 0; t <= 6000; t += 600) {
      layer.frame(seen, {}, t);
      layer.update(0.6);
    }
    return said;
  }
  return { floor, layer, look, pose, said };
}

const cellsOf = (said) =>
  said
    .filter(([topic]) => topic === "seen")
    .flatMap(([, cubes]) => cubes)
    .flatMap(([i, j, k, text]) => middles([i, j, k].map((n) => n * SIDE * CELL_M), text));

test("the first phone that sees a floor says how high it has it, and nothing else before", () => {
  const { look } = phone({ z: 0.3 });
  const said = look();
  assert.equal(said[0][0], "floor");
  assert.ok(Math.abs(said[0][1].z - (0.3 - 1.4)) < 1e-6);
  assert.deepEqual(cellsOf(said), []);
});

test("what a phone sees is told on the room's floor, however high its frame lies", () => {
  for (const z of [0, 0.25, -0.25]) {
    const { floor, look } = phone({ z });
    floor(-1.3);
    const cells = cellsOf(look());
    assert.ok(cells.length > 400);
    assert.ok(cells.every(([, , height]) => Math.abs(height + 1.3) <= CELL_M));
  }
});

test("who is not known well, or stands on another floor, adds nothing", () => {
  for (const [settings, height] of [[{ sigma: 0.3 }, -1.4], [{ z: 3 }, -1.4]]) {
    const { floor, look } = phone(settings);
    floor(height);
    assert.deepEqual(cellsOf(look()), []);
  }
});

test("who points at the floor marks it as far ahead as it is above the own one", () => {
  const { floor, layer, look, pose, said } = phone({ z: 0.25 });
  floor(-1.4);
  look();
  pose.quat_xyzw = [-Math.sin(Math.PI / 8), 0, 0, Math.cos(Math.PI / 8)]; // half down
  layer.select.end();
  const [topic, { position }] = said.at(-1);
  assert.equal(topic, "mark");
  [1.4, 0, -1.4].forEach((v, i) => assert.ok(Math.abs(position[i] - v) < 0.01, `${position}`));
});
