import assert from "node:assert/strict";
import { test } from "node:test";

import { PAGES } from "./support.js";

const axes = await import(new URL("axes.js", PAGES));
const placing = { x: 3, y: -1, z: 0.5, yaw: 0.7, scale: 1.02 };
const half = Math.SQRT1_2;

function near(a, b) {
  a.forEach((v, i) => assert.ok(Math.abs(v - b[i]) < 1e-12, `${a} instead of ${b}`));
}

test("forward, left and up of a y-up device are x, y and z", () => {
  near(axes.zUpFromYUp([0, 0, -1]), [1, 0, 0]);
  near(axes.zUpFromYUp([-1, 0, 0]), [0, 1, 0]);
  near(axes.zUpFromYUp([0, 1, 0]), [0, 0, 1]);
  near(axes.yUpFromZUp(axes.zUpFromYUp([1, 2, 3])), [1, 2, 3]);
});

test("the matrix of the common frame takes back what the frame does", () => {
  for (const up of ["y", "z"]) {
    const m = axes.deviceFromCommon(placing, up);
    const [x, y, z] = axes.commonFromDevice(placing, [0.3, -2, 5], up);
    near([0, 1, 2].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]), [0.3, -2, 5]);
    near(axes.deviceFromPoint(placing, [x, y, z], up), [0.3, -2, 5]);
  }
});

test("a phone that is held upright looks where its own -z shows in the common frame", () => {
  const looksLeft = [0, half, 0, half];
  assert.ok(Math.abs(axes.heading(axes.commonAttitude(placing, looksLeft), "y") - (0.7 + Math.PI / 2)) < 1e-12);
  assert.ok(Math.abs(axes.heading(axes.commonAttitude(placing, [0, 0, 0, 1], "z"), "z") - 0.7) < 1e-12);
});

test("a thing that stands upright in a phone's own axes stands upright in the common frame", () => {
  const attitude = axes.commonAttitude(placing, axes.UPRIGHT_IN_Y_UP, "y");
  near(axes.turned(attitude, [0, 0, 1]), [0, 0, 1]);
});

test("a frame that is not told has no placing", () => {
  assert.equal(axes.placingOf({ matrix: null, x: null }), null);
  assert.equal(axes.placingOf(undefined), null);
});

test("half of a turn is a turn by half of it, whatever the quaternions' signs", () => {
  near(axes.between([0, 0, 0, 1], [0, 0, -half, -half], 0.5), [0, 0, Math.sin(Math.PI / 8), Math.cos(Math.PI / 8)]);
});
