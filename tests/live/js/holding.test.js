import assert from "node:assert/strict";
import { test } from "node:test";

import { PAGES } from "./support.js";

const { Holding } = await import(new URL("xr/holding.js", PAGES));
const LEVEL = { x: 0, y: 0, z: 0, yaw: 0, scale: 1 };
const IDENTITY = [0, 0, 0, 1];

/** Ann's room: what is asked of it, and what it says of its objects. */
function room(...objects) {
  const client = { you: ["ann"], objects: new Map(), asked: [] };
  for (const object of objects) client.objects.set(object.id, { quat_xyzw: IDENTITY, holder: null, velocity: null, ...object });
  client.grab = (id) => client.asked.push(["grab", id]);
  client.move = (id, change) => client.asked.push(["move", id, change]);
  client.release = (id) => client.asked.push(["release", id]);
  client.give = (id, holder) => (client.objects.get(id).holder = holder);
  client.moves = () => client.asked.filter(([what]) => what === "move").map(([, , change]) => change);
  return client;
}

/** A hand at [x, y, z] of the common frame, whose ray goes along x, while the common frame lies at the device's own. */
function hand([x, y, z], quat_xyzw = IDENTITY) {
  return { position: [-y, z, -x], quat_xyzw };
}

function near(a, b) {
  a.forEach((v, i) => assert.ok(Math.abs(v - b[i]) < 1e-9, `${a} instead of ${b}`));
}

test("a hand takes what its ray meets, the one nearest to it, and nothing behind it or far beside it", () => {
  const cup = { id: "cup", position: [3, 0.1, 0] };
  const client = room(cup, { id: "ball", position: [2, 0.2, 0] }, { id: "back", position: [-1, 0, 0] }, { id: "far", position: [9, 0, 0] });
  const holding = new Holding(client);
  assert.equal(holding.take("finger", hand([0, 0, 0]), LEVEL), "cup");
  assert.equal(holding.take("finger", hand([0, 1, 0]), LEVEL), null);
  assert.deepEqual(client.asked, [["grab", "cup"], ["release", "cup"]]);
});

test("what is in the hand is taken wherever its ray goes", () => {
  const holding = new Holding(room({ id: "cup", position: [-0.1, 0.1, 0] }, { id: "ball", position: [2, 0, 0] }));
  assert.equal(holding.take("grip", hand([0, 0, 0]), LEVEL), "cup");
});

test("what somebody else holds is not asked for", () => {
  const holding = new Holding(room({ id: "cup", position: [2, 0, 0], holder: "ben" }));
  assert.equal(holding.take("finger", hand([0, 0, 0]), LEVEL), null);
});

test("what is held keeps its place in the hand, and the room hears of it once it has said whose it is", () => {
  const client = room({ id: "cup", position: [2, 0, 0] });
  const holding = new Holding(client);
  holding.take("finger", hand([0, 0, 0]), LEVEL);
  holding.follow("finger", hand([0, 0.5, 0]), LEVEL, 0);
  near(holding.poseOf("cup").position, [2, 0.5, 0]);
  assert.equal(client.moves().length, 0);
  client.give("cup", "ann");
  holding.follow("finger", hand([0, 0.6, 0]), LEVEL, 0.1);
  holding.follow("finger", hand([0, 0.61, 0]), LEVEL, 0.11);
  holding.follow("finger", hand([0, 0.8, 0]), LEVEL, 0.2);
  assert.equal(client.moves().length, 2, "not with each frame");
  near(client.moves()[1].position, [2, 0.8, 0]);
  near(client.moves()[1].velocity, [0, 2, 0]);
  // A quarter turn to the left, about the vertical.
  const [c, s] = [Math.cos(Math.PI / 4), Math.sin(Math.PI / 4)];
  holding.follow("finger", hand([0, 0, 0], [0, s, 0, c]), LEVEL, 0.3);
  near(client.moves()[2].position, [0, 2, 0]);
  near(client.moves()[2].quat_xyzw, [0, 0, s, c]);
  holding.let("finger");
  assert.equal(client.moves().at(-1).velocity, null);
  assert.deepEqual(client.asked.at(-1), ["release", "cup"]);
  assert.equal(holding.poseOf("cup"), null);
});

test("hands and things are put together where the common frame is shown", () => {
  const placing = { x: 10, y: -4, z: 1, yaw: Math.PI / 2, scale: 1 };
  const client = room({ id: "cup", position: [10, -2, 1] });
  const holding = new Holding(client);
  assert.equal(holding.take("finger", hand([0, 0, 0]), placing), "cup");
  client.give("cup", "ann");
  holding.follow("finger", hand([0, 1, 0]), placing, 0);
  near(client.moves()[0].position, [9, -2, 1]);
});

test("a hand lets go of what somebody was quicker to take, and of what is gone", () => {
  const client = room({ id: "cup", position: [2, 0, 0] }, { id: "ball", position: [2, 2, 0] });
  const holding = new Holding(client);
  holding.take("left", hand([0, 0, 0]), LEVEL);
  holding.take("right", hand([0, 2, 0]), LEVEL);
  client.give("cup", "ben");
  client.objects.delete("ball");
  holding.follow("left", hand([0, 0, 0]), LEVEL, 0);
  holding.follow("right", hand([0, 2, 0]), LEVEL, 0);
  assert.deepEqual(client.asked, [["grab", "cup"], ["grab", "ball"]]);
  assert.equal(holding.poseOf("cup"), null);
  holding.letAll();
  assert.equal(client.asked.length, 2);
});
