import assert from "node:assert/strict";
import { test } from "node:test";

import { PAGES, vectors } from "./support.js";

const { decodePoses, encodePose } = await import(new URL("poses.js", PAGES));
const { up, down } = await vectors("poses");

test("a pose has the bytes that Python gives it", () => {
  for (const { pose, hex } of up) assert.equal(Buffer.from(encodePose(pose)).toString("hex"), hex);
});

test("everybody's poses are read from the bytes that Python writes", () => {
  for (const { poses, hex } of down) {
    assert.deepEqual(decodePoses(new Uint8Array(Buffer.from(hex, "hex"))), poses);
  }
});

test("other bytes are refused", () => {
  const bytes = Buffer.from(down[1].hex, "hex");
  assert.throws(() => decodePoses(new Uint8Array(bytes.subarray(0, 5))), RangeError);
  assert.throws(() => decodePoses(new Uint8Array(bytes.subarray(0, bytes.length - 1))), RangeError);
  bytes[16 + 2] = 9;
  assert.throws(() => decodePoses(new Uint8Array(bytes)), RangeError);
});
