/**
 * Taking hold of the room's objects: by a finger on the screen, a controller's trigger or its grip. What is held keeps
 * its place in the hand; the room decides who holds it, and hears where it is.
 *
 * A hand is whatever a session calls one; its pose is that of its ray, which begins at it and goes along its own -z, in
 * the device's own frame (y up). `placing`: where the common frame is shown.
 */

import { commonAttitude, commonFromDevice, multiply, turned } from "../axes.js";

/** m along the ray. */
const REACH_M = 5;
/** m: what is so near to a hand is in it, wherever the ray goes. */
const AT_HAND_M = 0.2;
/** How far beside the ray something may be: m, and m for each m along it. */
const BESIDE_M = 0.12;
const BESIDE = 0.04;
/** s between words of where a held object is. */
const SAID_EVERY_S = 0.05;

export class Holding {
  #client;
  #hands = new Map();

  constructor(client) {
    this.#client = client;
  }

  /** A hand closes: it asks for what its ray meets. The object's id, or null where it meets nothing that is free. */
  take(hand, pose, placing) {
    this.let(hand);
    const own = inCommon(pose, placing);
    const object = this.#met(own);
    if (object === null) return null;
    const back = conjugate(own.quat_xyzw);
    const offset = turned(back, minus(object.position, own.position));
    const turn = multiply(back, object.quat_xyzw);
    const { position, quat_xyzw } = object;
    this.#hands.set(hand, { id: object.id, offset, turn, position, quat_xyzw, said: null });
    this.#client.grab(object.id);
    return object.id;
  }

  /** A closed hand is there at `t` (s). */
  follow(hand, pose, placing, t) {
    const held = this.#hands.get(hand);
    if (!held) return;
    const object = this.#client.objects.get(held.id);
    if (!object || (object.holder !== null && object.holder !== this.#own)) {
      this.#hands.delete(hand); // it is gone, or somebody was quicker
      return;
    }
    const own = inCommon(pose, placing);
    held.position = turned(own.quat_xyzw, held.offset).map((v, i) => v + own.position[i]);
    held.quat_xyzw = multiply(own.quat_xyzw, held.turn);
    if (object.holder !== this.#own) return;
    const { said, position, quat_xyzw } = held;
    if (said && t - said.t < SAID_EVERY_S) return;
    const velocity = said ? minus(position, said.position).map((v) => v / (t - said.t)) : null;
    held.said = { t, position };
    this.#client.move(held.id, { position, quat_xyzw, velocity });
  }

  /** A hand opens: what it held stays where it is. */
  let(hand) {
    const held = this.#hands.get(hand);
    if (!held) return;
    this.#hands.delete(hand);
    const { id, said, position, quat_xyzw } = held;
    if (said) this.#client.move(id, { position, quat_xyzw, velocity: null });
    this.#client.release(id);
  }

  /** All hands open: the device does not know any more where it is. */
  letAll() {
    for (const hand of [...this.#hands.keys()]) this.let(hand);
  }

  /** Where something is that a hand holds, {position, quat_xyzw} in the common frame; null where none does. */
  poseOf(id) {
    for (const held of this.#hands.values()) if (held.id === id) return held;
    return null;
  }

  get #own() {
    return this.#client.you[0];
  }

  /** What is nearest to the ray. */
  #met({ position, quat_xyzw }) {
    const way = turned(quat_xyzw, [0, 0, -1]);
    let [met, least] = [null, Infinity];
    for (const object of this.#client.objects.values()) {
      if (object.holder !== null && object.holder !== this.#own) continue;
      const there = minus(object.position, position);
      const distance = Math.hypot(...there);
      const along = there.reduce((sum, v, i) => sum + v * way[i], 0);
      const beside = Math.sqrt(Math.max(0, distance ** 2 - along ** 2));
      const inHand = distance <= AT_HAND_M;
      if (!inHand && (along <= 0 || along > REACH_M || beside > BESIDE_M + BESIDE * along)) continue;
      const off = inHand ? distance / REACH_M - 1 : beside / along;
      if (off < least) [met, least] = [object, off];
    }
    return met;
  }
}

function inCommon({ position, quat_xyzw }, placing) {
  return { position: commonFromDevice(placing, position), quat_xyzw: commonAttitude(placing, quat_xyzw) };
}

function minus(a, b) {
  return a.map((v, i) => v - b[i]);
}

function conjugate([x, y, z, w]) {
  return [-x, -y, -z, w];
}
