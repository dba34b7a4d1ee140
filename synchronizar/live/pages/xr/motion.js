/** Where the others are at each frame that is drawn, between the poses that the room sends 30 times a second. */

import { between } from "../axes.js";

/** s: so far in the past they are shown, so that a pose is there to go to in most networks. */
export const DELAY_S = 0.12;
/** s: without a newer pose somebody stands where it was last, and fades. */
const OLD_S = 2;
const KEPT = 12;
/** m: a longer step between two poses is a correction, not a walk, and is faded over. */
const JUMP_M = 0.5;

/** One member's poses by the room's clock. */
export class Motion {
  #poses = [];

  add(t, position, quat_xyzw, state) {
    const last = this.#poses.at(-1);
    if (last && t < last.t + 0.001) return;
    if (last && Math.hypot(...position.map((v, i) => v - last.position[i])) > JUMP_M) this.#poses = [];
    this.#poses.push({ t, position, quat_xyzw, state });
    if (this.#poses.length > KEPT) this.#poses.shift();
  }

  /**
   * {t, position, quat_xyzw, state, opacity}, as at `now` by the room's clock, or rather at `t`, a little before;
   * null where nothing was heard for long.
   */
  at(now) {
    const t = now - DELAY_S;
    const poses = this.#poses;
    if (!poses.length) return null;
    const next = poses.findIndex((pose) => pose.t >= t);
    const last = poses.at(-1);
    if (next === -1) {
      const opacity = Math.max(0, 1 - Math.max(0, t - last.t - 0.5) / OLD_S);
      return opacity > 0 ? { ...last, opacity } : null;
    }
    const after = poses[next];
    if (next === 0) return { ...after, opacity: 1 };
    const before = poses[next - 1];
    const share = (t - before.t) / (after.t - before.t);
    const position = before.position.map((v, i) => v + share * (after.position[i] - v));
    return { t, position, quat_xyzw: between(before.quat_xyzw, after.quat_xyzw, share), state: after.state, opacity: 1 };
  }
}
