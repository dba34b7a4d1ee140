import assert from "node:assert/strict";
import { test } from "node:test";

import { PAGES, vectors, welcome } from "./support.js";

const { Camera } = await import(new URL("view/camera.js", PAGES));
const { colourOf, residualColour } = await import(new URL("view/colours.js", PAGES));
const { RoomModel, TRAIL_S, extend } = await import(new URL("room/model.js", PAGES));
const { pieces } = await import(new URL("view/top_view.js", PAGES));
const { Motion, DELAY_S } = await import(new URL("xr/motion.js", PAGES));
const { wayOf } = await import(new URL("xr/cue.js", PAGES));
const { codeOf, spelled } = await import(new URL("visit.js", PAGES));
const { advice, stateOf } = await import(new URL("words.js", PAGES));
const IDENTITY = [0, 0, 0, 1];

function near(a, b, within = 1e-9) {
  a.forEach((v, i) => assert.ok(Math.abs(v - b[i]) < within, `${a} instead of ${b}`));
}

/** A client of whom only events and members matter. */
function client(members = []) {
  const made = new EventTarget();
  made.members = new Map(members.map((member) => [member.index, { here: true, static: false, up: "z", frame: 0, ...member }]));
  made.tell = (type, detail) => made.dispatchEvent(new CustomEvent(type, { detail }));
  return made;
}

test("a camera that follows has everybody on the canvas, and y upwards", () => {
  const camera = new Camera();
  camera.resize(800, 400);
  camera.follow([[0, 0], [10, 4]], 0, true);
  for (const [x, y] of [[0, 0], [10, 4]].map((p) => camera.toScreen(p))) {
    assert.ok(x > 0 && x < 800 && y > 0 && y < 400);
  }
  assert.ok(camera.toScreen([0, 1])[1] < camera.toScreen([0, 0])[1]);
  near(camera.toRoom(camera.toScreen([3, -2])), [3, -2]);
});

test("a camera zooms about what is pointed at, and follows nobody then", () => {
  const camera = new Camera();
  camera.resize(800, 400);
  const pointed = camera.toRoom([200, 100]);
  camera.zoom(2, [200, 100]);
  near(camera.toRoom([200, 100]), pointed);
  camera.follow([[100, 100]], 1, true);
  near(camera.toRoom([200, 100]), pointed);
});

test("a track is kept for a while, and breaks where somebody jumps", () => {
  const trail = [];
  for (let k = 0; k <= 300; k++) extend(trail, 0.1 * k, 0.1 * k, 0);
  assert.ok(trail.every((point) => point !== null && point.t >= 30 - TRAIL_S - 1e-9));
  extend(trail, 30.1, 60, 0);
  assert.deepEqual(trail.at(-2), null);
});

test("a track is drawn in few pieces, each of which begins where the one before ends", () => {
  const trail = [];
  for (let k = 0; k <= 150; k++) extend(trail, 0.1 * k, 0.1 * k, 0);
  trail.push(null, { t: 15.1, x: 60, y: 0 }, { t: 15.2, x: 60.1, y: 0 });
  const made = pieces(trail, 15.2);
  assert.ok(made.length <= 16);
  assert.equal(made.reduce((sum, { points }) => sum + points.length - 1, 0), 151);
  for (let i = 1; i < made.length - 1; i++) assert.equal(made[i].points[0], made[i - 1].points.at(-1));
  assert.equal(made.at(-1).points.length, 2);
  assert.ok(made.every(({ share }, i) => i === 0 || share >= made[i - 1].share));
});

test("the model knows who is where, from what the room says", async () => {
  const made = client([{ name: "ann", index: 0 }, { name: "ben", index: 40, up: "y" }]);
  const model = new RoomModel(made);
  const covariance = [
    [0.01, 0, 0, 0],
    [0, 0.04, 0, 0],
    [0, 0, 0.01, 0],
    [0, 0, 0, 0],
  ];
  const frame = { state: "registered", matrix: [], x: 0, y: 0, z: 0, yaw: 0, scale: 1, covariance };
  made.tell("welcome", { ...welcome([]), frames: { users: { ann: frame }, reference: "ann" } });
  const { decodePoses } = await import(new URL("poses.js", PAGES));
  const { poses } = decodePoses(new Uint8Array(Buffer.from((await vectors("poses")).down[1].hex, "hex")));
  for (const pose of poses) pose.name = made.members.get(pose.member).name;
  made.tell("poses", { t: 100, poses });
  const [ann, ben] = model.present;
  near([ann.pose.x, ann.pose.y, ann.pose.z, ann.pose.heading], [1, -2, 3, 0]);
  near([ann.pose.ellipse.major, ann.pose.ellipse.minor], [0.2, 0.1]);
  assert.equal(ben.pose.ellipse, null);
  made.tell("poses", { t: 100.1, poses: [] });
  assert.notEqual(model.users.get("ann").pose, null);
  made.tell("poses", { t: 101, poses: [] });
  assert.equal(model.users.get("ann").pose, null);
  made.members.delete(40);
  made.tell("members", {});
  assert.deepEqual([...model.users.keys()], ["ann"]);
});

test("somebody is shown between two poses, a little late, and fades when none comes", () => {
  const motion = new Motion();
  motion.add(10, [0, 0, 0], IDENTITY, "registered");
  motion.add(10.1, [0.1, 0, 0], IDENTITY, "registered");
  near(motion.at(10.05 + DELAY_S).position, [0.05, 0, 0]);
  assert.equal(motion.at(10.05 + DELAY_S).opacity, 1);
  assert.ok(motion.at(11.5).opacity < 1);
  assert.equal(motion.at(20), null);
});

test("a jump is not drawn as a walk, and an old pose does not come back", () => {
  const motion = new Motion();
  motion.add(10, [0, 0, 0], IDENTITY, "registered");
  motion.add(10.1, [5, 0, 0], IDENTITY, "registered");
  motion.add(10.05, [0, 0, 0], IDENTITY, "registered");
  near(motion.at(10.05 + DELAY_S).position, [5, 0, 0]);
});

test("an arrow points as the words say", () => {
  near(["walk 3 m straight on", "walk 2 m to your left", "walk 1 m back to your right"].map(wayOf), [
    0,
    Math.PI / 2,
    (-3 * Math.PI) / 4,
  ]);
  assert.equal(wayOf("walk 3 m back"), Math.PI);
  for (const words of ["walk 3 m towards bob", "walk 3 m to the left, as you look at bob", "", null]) {
    assert.equal(wayOf(words), null);
  }
});

test("a code is read however it is written", () => {
  assert.equal(codeOf("#abcd-ef 23"), "ABCDEF23");
  assert.equal(codeOf("#ABCD%20EF23"), "ABCDEF23");
  assert.equal(codeOf("#%"), "%");
  assert.equal(spelled("ABCDEF23"), "ABCD-EF23");
});

test("who has no place yet is told what to do", () => {
  assert.equal(advice({ state: "registered", matrix: [] }), "");
  assert.equal(advice({ state: "unobservable", cue: "walk 3 m back", matrix: null }), "Walk 3 m back.");
  assert.ok(advice(undefined).endsWith("."));
  assert.equal(stateOf({ state: "registered", matrix: null }), "unobservable");
});

test("people's colours differ, and a range's tells too long from too short without red and green", () => {
  for (const dark of [false, true]) {
    assert.equal(new Set([...Array(8).keys()].map((i) => colourOf(i, dark))).size, 8);
    assert.notEqual(residualColour(0.5, dark), residualColour(-0.5, dark));
    assert.equal(residualColour(9, dark), residualColour(0.5, dark));
    assert.equal(residualColour(0, dark), residualColour(null, dark));
  }
});
