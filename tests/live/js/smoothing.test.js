import assert from "node:assert/strict";
import { test } from "node:test";

import { PAGES, vectors } from "./support.js";

const { SMOOTHING, Smoother, ellipse, wrap } = await import(new URL("smoothing.js", PAGES));

function same(returned, wanted) {
  if (wanted === null) return assert.equal(returned, null);
  for (const [name, value] of Object.entries(wanted)) {
    assert.ok(Math.abs(returned[name] - value) < 1e-9, `${name}: ${returned[name]} instead of ${value}`);
  }
}

for (const [name, calls] of Object.entries(await vectors("smoothing"))) {
  test(`it does as the vectors say: ${name}`, () => {
    const smoother = new Smoother();
    for (const call of calls) {
      if (call.call === "solved") {
        same(smoother.solved(call.t, call.placing, call.covariance, call.at), call.returns);
      } else if (call.call === "step") {
        const shown = smoother.step(call.dt, call.at, call.in_view);
        same(shown && { ...shown.placing, opacity: shown.opacity }, call.returns);
      } else {
        smoother[call.call]();
      }
    }
  });
}

test("the rule's numbers are those of Python", () => {
  if (!process.env.SMOOTHING) return;
  assert.deepEqual({ ...SMOOTHING }, JSON.parse(process.env.SMOOTHING));
});

test("half-axes and direction of an ellipse", () => {
  const turned = ellipse([
    [2.5, 1.5],
    [1.5, 2.5],
  ]);
  assert.ok(Math.abs(turned.major - 2) < 1e-12);
  assert.ok(Math.abs(turned.minor - 1) < 1e-12);
  assert.ok(Math.abs(turned.direction - Math.PI / 4) < 1e-12);
});

test("angles are wrapped into [-pi, pi)", () => {
  assert.equal(wrap(Math.PI), -Math.PI);
  assert.ok(Math.abs(wrap(-7) - (2 * Math.PI - 7)) < 1e-12);
});
