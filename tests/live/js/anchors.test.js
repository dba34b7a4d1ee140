import assert from "node:assert/strict";
import { test } from "node:test";

import { PAGES, settled } from "./support.js";

const { Anchored, Anchors } = await import(new URL("xr/anchors.js", PAGES));
const { ArSession } = await import(new URL("xr/session.js", PAGES));
const FRAME_S = 1 / 60;

/** A session whose SLAM has anchors, and moves them all as the test says. */
function slam({ refuses = false } = {}) {
  const made = [];
  async function anchorAt(position) {
    if (refuses) return null;
    const anchor = { position, ended: false, end: () => (anchor.ended = true) };
    made.push(anchor);
    return anchor;
  }
  return { made, anchorAt };
}

test("what stands near gets an anchor, what is far or gone has none, and there are not too many", async () => {
  const session = slam();
  const anchors = new Anchors(session);
  const things = Array.from({ length: 20 }, (_, k) => [`thing ${k}`, [0.3 * k, 0, 0]]);
  anchors.update(things, [0, 0, 0]);
  await settled();
  assert.equal(anchors.count, 12);
  assert.deepEqual(anchors.at("thing 3"), [0.3 * 3, 0, 0]);
  assert.equal(anchors.at("thing 15"), null, "others are nearer");
  anchors.update(things.slice(0, 1), [7, 0, 0]);
  assert.equal(anchors.count, 1, "near enough to keep it");
  anchors.update(things.slice(0, 1), [9, 0, 0]);
  assert.equal(anchors.count, 0);
  assert.ok(session.made.every(({ ended }) => ended));
});

test("an anchor that comes too late is given back, and a device without anchors has none", async () => {
  const session = slam();
  const anchors = new Anchors(session);
  anchors.update([["cup", [1, 0, 0]]], [0, 0, 0]);
  anchors.clear();
  await settled();
  assert.equal(anchors.count, 0);
  assert.ok(session.made[0].ended);
  const without = new Anchors(slam({ refuses: true }));
  without.update([["cup", [1, 0, 0]]], [0, 0, 0]);
  await settled();
  assert.equal(without.at("cup"), null);
});

test("a thing goes with its anchor at once, and back to where the frame has it so slowly that nobody sees it", () => {
  const thing = new Anchored();
  assert.deepEqual(thing.step(FRAME_S, [1, 0, -2], [1, 0, -2]), [1, 0, -2]);
  let [x] = thing.step(FRAME_S, [1, 0, -2], [1.1, 0, -2]);
  assert.ok(Math.abs(x - 1.1) < 0.001);
  for (let k = 0; k < 60 * 10 && x !== 1; k++) {
    const [next] = thing.step(FRAME_S, [1, 0, -2], [1.1, 0, -2]);
    assert.ok(next <= x && x - next < 0.001, "not seen to swim");
    x = next;
  }
  assert.equal(x, 1);
});

test("when the room's frame comes after the anchor nothing has moved twice", () => {
  const thing = new Anchored();
  thing.step(FRAME_S, [0, 0, 0], [0, 0, 0]);
  thing.step(FRAME_S, [0, 0, 0], [0.2, 0, 0]);
  let x;
  for (let k = 0; k < 60 * 20; k++) [x] = thing.step(FRAME_S, [Math.min(0.2, 0.0005 * k), 0, 0], [0.2, 0, 0]);
  assert.ok(Math.abs(x - 0.2) < 1e-9);
});

test("without an anchor a thing is where the frame has it, and one that SLAM lost for a while does not jump", () => {
  const thing = new Anchored();
  assert.deepEqual(thing.step(FRAME_S, [1, 2, 3], null), [1, 2, 3]);
  thing.step(FRAME_S, [1, 2, 3], [1, 2, 3]);
  thing.step(FRAME_S, [1, 2, 3], null);
  assert.deepEqual(thing.step(FRAME_S, [1, 2, 3], [1.4, 2, 3]), [1, 2, 3]);
  assert.deepEqual(thing.step(FRAME_S, [5, 2, 3], [1.4, 2, 3]), [5, 2, 3], "faded in anew");
});

/** A browser's AR: its session, its frames, and poses of spaces as the test says. */
function browser(t, { anchors = true } = {}) {
  const session = new EventTarget();
  session.end = async () => session.dispatchEvent(new Event("end"));
  const poses = new Map();
  const space = new EventTarget();
  const asked = [];
  const transform = ({ x, y, z }) => ({ position: { x, y, z }, orientation: { x: 0, y: 0, z: 0, w: 1 } });
  const frame = {
    getViewerPose: () => ({ transform: transform({ x: 0, y: 1.5, z: 0 }) }),
    getPose: (of) => (poses.has(of) ? { transform: transform(poses.get(of)) } : null),
  };
  if (anchors) {
    frame.createAnchor = async ({ x, y, z }) => {
      const anchor = { anchorSpace: {}, deleted: false, delete: () => (anchor.deleted = true) };
      poses.set(anchor.anchorSpace, { x, y, z });
      asked.push(anchor);
      return anchor;
    };
  }
  const before = [globalThis.XRRigidTransform, Object.getOwnPropertyDescriptor(globalThis, "navigator")];
  globalThis.XRRigidTransform = class {
    constructor(position) {
      Object.assign(this, position);
    }
  };
  const xr = { requestSession: async (_, options) => Object.assign(session, { options }) };
  Object.defineProperty(globalThis, "navigator", { value: { xr }, configurable: true });
  t.after(() => {
    globalThis.XRRigidTransform = before[0];
    if (before[1]) Object.defineProperty(globalThis, "navigator", before[1]);
  });
  let loop;
  const renderer = {
    xr: { setSession: async () => {}, getReferenceSpace: () => space },
    setAnimationLoop: (draw) => (loop = draw),
  };
  const input = (kind, hand) => session.dispatchEvent(Object.assign(new Event(kind), { frame, inputSource: hand }));
  return { session, poses, asked, renderer, input, draw: (time) => loop(time, frame) };
}

test("an anchor is made within a frame, followed with each, and ended; its session asks for the feature", async (t) => {
  const { session, poses, asked, renderer, draw } = browser(t);
  const ar = new ArSession();
  await ar.start(renderer, null, () => {});
  assert.ok(session.options.optionalFeatures.includes("anchors"));
  const promised = ar.anchorAt([1, 2, 3]);
  draw(0);
  const anchor = await promised;
  draw(16);
  assert.deepEqual(anchor.position, [1, 2, 3]);
  poses.set(asked[0].anchorSpace, { x: 1.5, y: 2, z: 3 });
  draw(32);
  assert.deepEqual(anchor.position, [1.5, 2, 3]);
  poses.delete(asked[0].anchorSpace);
  draw(48);
  assert.equal(anchor.position, null);
  anchor.end();
  assert.ok(asked[0].deleted);
});

test("where SLAM has no anchors nobody waits for one", async (t) => {
  const { renderer, draw } = browser(t, { anchors: false });
  const ar = new ArSession();
  assert.equal(await ar.anchorAt([0, 0, 0]), null);
  await ar.start(renderer, null, () => {});
  const promised = ar.anchorAt([0, 0, 0]);
  draw(0);
  assert.equal(await promised, null);
  assert.equal(await ar.anchorAt([0, 0, 0]), null);
});

test("a finger and a grip take, hold with each frame and let go, also when the session ends", async (t) => {
  const { session, poses, renderer, input, draw } = browser(t);
  const ar = new ArSession();
  await ar.start(renderer, null, () => {});
  const heard = [];
  for (const type of ["take", "hold", "let"]) {
    ar.addEventListener(type, ({ detail }) => heard.push([type, detail.hand.name, detail.position?.[0]]));
  }
  const [finger, grip] = ["finger", "grip"].map((name, x) => {
    const hand = { name, targetRaySpace: {} };
    poses.set(hand.targetRaySpace, { x, y: 0, z: 0 });
    return hand;
  });
  input("selectstart", finger);
  draw(0);
  input("squeezestart", grip);
  poses.set(finger.targetRaySpace, { x: 5, y: 0, z: 0 });
  draw(16);
  input("selectend", finger);
  draw(32);
  await session.end();
  assert.deepEqual(heard, [
    ["take", "finger", 0],
    ["hold", "finger", 0],
    ["take", "grip", 1],
    ["hold", "finger", 5],
    ["hold", "grip", 1],
    ["let", "finger", undefined],
    ["hold", "grip", 1],
    ["let", "grip", undefined],
  ]);
});
