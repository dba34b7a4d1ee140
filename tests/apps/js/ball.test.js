import "./resolve.js";

import assert from "node:assert/strict";
import { test } from "node:test";

const { GRAVITY, HAND_M, Shown, arc, flown, handOf, swing, thrown, wayTo, words } = await import(
  "../../../synchronizar/apps/catch/pages/ball.js"
);
const told = JSON.parse(process.env.CATCH);

const near = (a, b, within = 1e-9) => a.forEach((v, i) => assert.ok(Math.abs(v - b[i]) <= within, `${a} is not ${b}`));

test("gravity and the hand are the game's", () => {
  assert.equal(GRAVITY, told.gravity);
  assert.equal(HAND_M, told.hand);
});

test("the arc is the one that the game has worked out", () => {
  for (const { flight, t, at } of told.flights) near(flown(flight, t), at);
});

test("hands are where the game has them", () => {
  for (const { position, quat_xyzw, up, at } of told.hands) near(handOf(position, quat_xyzw, up), at, 1e-6);
});

test("an arc is drawn down to the floor and no further", () => {
  const flight = { t: 10, position: [0, 0, 1], velocity: [1, 0, 2] };
  const points = arc(flight, 10, 0);
  assert.ok(points.length > 20);
  assert.ok(points.every(([, , z]) => z >= 0));
  near(points[0], [0, 0, 1]);
});

test("a ball that changes hands glides: no step is longer than it moves by itself and a share of the way", () => {
  const shown = new Shown();
  const dt = 1 / 60;
  let last = shown.step(dt, "held ann", [0, 0, 0]);
  for (let i = 0; i < 60; i++) {
    const now = shown.step(dt, "held ben", [0.5, 0, 0]);
    assert.ok(Math.hypot(...now.map((v, k) => v - last[k])) < 0.08);
    last = now;
  }
  near(last, [0.5, 0, 0], 1e-3);
});

test("a ball that is found again elsewhere is there at once", () => {
  const shown = new Shown();
  shown.step(0.1, "held ann", [0, 0, 0]);
  shown.forget();
  near(shown.step(0.1, "lies", [2, 0, 0]), [2, 0, 0]);
});

test("a swing is the speed of the last tenth of a second, and a still hand has none", () => {
  const places = Array.from({ length: 20 }, (_, i) => ({ t: 16 * i, position: [0, 0, i < 10 ? 0 : -0.016 * 3 * (i - 9)] }));
  near(swing(places), [0, 0, -3], 1e-9);
  near(swing(places.slice(0, 9)), [0, 0, 0]);
  near(swing([]), [0, 0, 0]);
});

test("a throw goes where the phone looks, faster with a swing, and up a little", () => {
  near(thrown([0, 0, 0, 1], [0, 0, 0], [0, 1, 0]), [0, 1, -2]);
  const [, up, ahead] = thrown([0, 0, 0, 1], [0, 0, -3], [0, 1, 0]);
  assert.ok(ahead < -5 && up === 1);
});

test("a way is told as who looks there sees it", () => {
  const ahead = [0, 0, 0, 1]; // looks along -z, x is to the right
  assert.equal(wayTo([0, 0, 0], ahead, [0, -1, -2]), "2 m ahead");
  assert.equal(wayTo([0, 0, 0], ahead, [3, 0, 0]), "3 m to your right");
  assert.equal(wayTo([0, 0, 0], ahead, [-3, 0, -1]), "3 m to your left");
  assert.equal(wayTo([1, 0, 0], ahead, [1, 0, 0.2]), "1 m behind you");
});

test("everybody reads what to do", () => {
  assert.match(words(null, null, "ann").line, /two are in place/);
  const held = { data: { phase: "held", by: "ann" } };
  assert.match(words(null, held, "ann").line, /You have the ball/);
  assert.equal(words({ data: { rally: 3, best: 5 } }, held, "ben").line, "ann has the ball.");
});
