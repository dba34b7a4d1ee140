import assert from "node:assert/strict";
import { test } from "node:test";

import { PAGES } from "./support.js";

const { Floor } = await import(new URL("xr/floor.js", PAGES));

/** `count` points of a surface that high, by a device at 1.4 m, with some noise. */
function level(floor, height, count) {
  for (let n = 0; n < count; n++) floor.add(height + 0.01 * Math.sin(n), 1.4);
}

test("the floor is the lowest level surface, not what lies lower by mistake, and no table", () => {
  const floor = new Floor();
  assert.equal(floor.height, null);
  level(floor, 0.75, 500); // a table: not far enough below the device
  assert.equal(floor.height, null);
  level(floor, -0.8, 10);
  level(floor, 0.05, 300);
  level(floor, 0.4, 200);
  assert.ok(Math.abs(floor.height - 0.05) < 0.01);
});

test("a floor is not known by a few points, nor after the device has begun anew", () => {
  const floor = new Floor();
  level(floor, 0, 30);
  assert.equal(floor.height, null);
  level(floor, 0, 300);
  assert.ok(floor.height !== null);
  floor.clear();
  assert.equal(floor.height, null);
});
