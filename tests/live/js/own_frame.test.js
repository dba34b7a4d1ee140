import assert from "node:assert/strict";
import { test } from "node:test";

import { PAGES } from "./support.js";

const { OwnFrame } = await import(new URL("xr/own_frame.js", PAGES));
const COVARIANCE = [0, 1, 2, 3].map((i) => [0, 1, 2, 3].map((j) => (i === j ? 1e-4 : 0)));

/** A phone called ann, of whom the room tells. */
function phone() {
  const client = new EventTarget();
  const member = { name: "ann", frame: 0 };
  Object.assign(client, { you: ["ann"], member: () => member });
  const own = new OwnFrame(client);
  const moved = [];
  own.addEventListener("moved", ({ detail }) => moved.push(detail.distance));
  const tell = (t, x, { state = "registered", frame = 0, matrix = [] } = {}) => {
    const told = { state, frame, matrix, x, y: 0, z: 0, yaw: 0, scale: 1, covariance: COVARIANCE };
    client.dispatchEvent(new CustomEvent("frames", { detail: { t, users: { ann: told } } }));
  };
  return { own, member, moved, tell };
}

test("nothing stands in place before this device is registered", () => {
  const { own, tell } = phone();
  tell(0, 1, { state: "unobservable" });
  assert.equal(own.step(0.02, "things"), null);
  assert.equal(own.opacity, 0);
  tell(1, 1);
  assert.equal(own.step(1, "things").x, 1);
  assert.equal(own.opacity, 1);
});

test("what was in place stays, and pales, while this device is not sure of it", () => {
  const { own, tell } = phone();
  tell(0, 1);
  own.step(1, "things");
  tell(1, 5, { state: "unobservable" });
  assert.equal(own.step(0.02, "things").x, 1);
  assert.ok(own.opacity > 0 && own.opacity < 0.5);
});

test("what is told of an earlier frame of its SLAM is not drawn with", () => {
  const { own, member, tell } = phone();
  tell(0, 1);
  own.step(1, "things");
  member.frame = 1;
  own.forget();
  tell(1, 1, { frame: 0 });
  assert.equal(own.step(0.02, "things"), null);
  tell(2, 7, { frame: 1 });
  assert.equal(own.step(0.02, "things").x, 7);
});

test("a correction beyond what was told is told, one after it was lost is not", () => {
  const { moved, tell } = phone();
  tell(0, 0);
  tell(0.5, 0.4);
  tell(1, 0.4, { state: "unobservable" });
  tell(2, 3);
  assert.deepEqual(moved, [0.4]);
});
