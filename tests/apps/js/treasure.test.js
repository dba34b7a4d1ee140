import "./resolve.js";

import assert from "node:assert/strict";
import { test } from "node:test";

const { ghostAt, standing, words } = await import("../../../synchronizar/apps/treasure/pages/model.js");

const score = { found: true, by: [], playing: null, left: 0, things: 4, coins: {}, best: [] };

test("a ghost goes between its points, and is not there before and after", () => {
  const ghost = { began: 100, path: [[0, 0, 0, 1], [1, 2, 0, 1], [3, 2, 4, 1]] };
  assert.equal(ghostAt(ghost, 99.9), null);
  assert.deepEqual(ghostAt(ghost, 100), [0, 0, 1]);
  assert.deepEqual(ghostAt(ghost, 100.5), [1, 0, 1]);
  assert.deepEqual(ghostAt(ghost, 102), [2, 2, 1]);
  assert.equal(ghostAt(ghost, 103.1), null);
  assert.equal(ghostAt({ began: 0, path: [] }, 0), null);
});

test("a game that is not found says by what it can be", () => {
  assert.match(words({ ...score, found: false, by: ["door", "shelf"] }, "ann").line, /door, shelf/);
  assert.match(words({ ...score, found: false }, "ann").line, /cannot be found/);
  assert.match(words(null, "ann").line, /being opened/);
});

test("players read their own coins, who only looks those that are left", () => {
  const playing = { ...score, playing: 12, left: 1, coins: { ann: 3, ben: 5 } };
  assert.equal(words(playing, "ann").head, "You: 3 · 1 coin left");
  assert.equal(words(playing, null).head, "1 coin left");
  assert.equal(words({ ...playing, left: 2 }, "cem").line, "Walk to the start.");
  assert.deepEqual(standing(playing), [["ben", 5], ["ann", 3]]);
});
