/**
 * Things near the device hang on anchors of its own SLAM, where it has them. When SLAM corrects its map, anchors move
 * with what the camera sees; the room hears of that by poses only, and its frame follows seconds later.
 *
 * All in the device's own frame (y up), m.
 */

import { SMOOTHING } from "../smoothing.js";

/** Things within so far get an anchor, ... */
const NEAR_M = 5;
/** ... and keep it until they are so far away. */
const FAR_M = 8;
/** SLAM follows each of them. */
const MOST = 12;

/** The anchors of things that stand, by their ids. */
export class Anchors {
  #session;
  #known = new Map();

  /** `session`: whose `anchorAt(position)` promises {position, end}, or null where there are none. */
  constructor(session) {
    this.#session = session;
  }

  /** How many there are. */
  get count() {
    return [...this.#known.values()].filter(({ anchor }) => anchor !== null).length;
  }

  /** What stands where, [id, position] each; the device is `here`. */
  update(things, here) {
    const distance = new Map(things.map(([id, position]) => [id, away(position, here)]));
    for (const id of [...this.#known.keys()]) if (!(distance.get(id) <= FAR_M)) this.drop(id);
    const near = things.filter(([id]) => distance.get(id) <= NEAR_M && !this.#known.has(id));
    near.sort(([a], [b]) => distance.get(a) - distance.get(b));
    for (const [id, position] of near.slice(0, MOST - this.#known.size)) this.#ask(id, position);
  }

  /** Where a thing's anchor is now; null where it has none, or SLAM does not see it. */
  at(id) {
    return this.#known.get(id)?.anchor?.position ?? null;
  }

  /** A thing does not stand any more where it stood. */
  drop(id) {
    this.#known.get(id)?.anchor?.end();
    this.#known.delete(id);
  }

  /** SLAM began another frame. */
  clear() {
    for (const id of [...this.#known.keys()]) this.drop(id);
  }

  async #ask(id, position) {
    const asked = { anchor: null };
    this.#known.set(id, asked);
    const anchor = await this.#session.anchorAt(position);
    if (this.#known.get(id) === asked) asked.anchor = anchor;
    else anchor?.end();
  }
}

/** One thing: where it is drawn, between where the shown frame has it and where its anchor took it. */
export class Anchored {
  #goal = null;
  #anchor = null;
  #taken = [0, 0, 0];

  /**
   * Where to draw, `dt` s after the last time. `goal`: where the shown frame has it; `anchor`: where its anchor is, or
   * null. What the anchor was moved by is taken back as slowly as a frame's error is: by then the room's frame has it.
   */
  step(dt, goal, anchor) {
    const p = SMOOTHING;
    if (this.#goal && away(goal, this.#goal) > p.fade_beyond) this.#taken = [0, 0, 0]; // faded in anew
    if (anchor && this.#anchor) this.#taken = this.#taken.map((v, i) => v + anchor[i] - this.#anchor[i]);
    const error = Math.hypot(...this.#taken);
    const kept = error > 0 ? Math.max(0, 1 - (dt * (p.least_speed + p.rate * error)) / error) : 0;
    this.#taken = this.#taken.map((v) => kept * v);
    [this.#goal, this.#anchor] = [goal, anchor];
    return goal.map((v, i) => v + this.#taken[i]);
  }
}

function away(a, b) {
  return Math.hypot(...a.map((v, i) => v - b[i]));
}
