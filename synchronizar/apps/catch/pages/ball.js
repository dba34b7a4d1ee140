/** The ball as the game tells of it, at any moment. No elements, no drawing. */

import { turned } from "../../pages/axes.js";

/** Kinds of the game's objects, and their ids. */
export const BALL = "catch ball";
export const SCORE = "catch score";
/** m/s^2, as in flight.py. */
export const GRAVITY = 4;
/** m in front of a device, as in synchronizar/live/stage.py. */
export const HAND_M = 0.35;
/** s in which a page that has shown it elsewhere comes back to where it is. */
const SETTLING_S = 0.12;
/** m: farther off it is put there at once. */
const FARTHEST_M = 3;

/** Where a flight is at `t` by the room's clock: p0 + v0 s - g s^2 / 2. */
export function flown({ t: begun, position: [x, y, z], velocity: [vx, vy, vz] }, t) {
  const s = Math.max(0, t - begun);
  return [x + vx * s, y + vy * s, z + vz * s - 0.5 * GRAVITY * s * s];
}

/** Points of the arc from `t` on, `step` s apart, down to the floor: [[x, y, z], ...]. */
export function arc(flight, t, floor, step = 0.05) {
  const points = [];
  for (let at = Math.max(t, flight.t); points.length < 200; at += step) {
    const point = flown(flight, at);
    if (point[2] < floor) break;
    points.push(point);
  }
  return points;
}

/** Where a device that is there and looks so holds the ball, in the same axes. */
export function handOf(position, quat_xyzw, up) {
  const forward = turned(quat_xyzw, up === "y" ? [0, 0, -1] : [1, 0, 0]);
  return position.map((v, i) => v + HAND_M * forward[i]);
}

/** What is shown follows what is told without a jump: at a throw or a catch it is a little elsewhere, and glides. */
export class Shown {
  #off = [0, 0, 0];
  #last = null;
  #phase = "";

  /** The place to draw it, `dt` s after the last time; `phase`: another one lets it glide from where it was. */
  step(dt, phase, goal) {
    if (this.#last !== null && phase !== this.#phase) {
      const off = this.#last.map((v, i) => v - goal[i]);
      this.#off = Math.hypot(...off) < FARTHEST_M ? off : [0, 0, 0];
    }
    this.#phase = phase;
    const left = Math.exp(-dt / SETTLING_S);
    this.#off = this.#off.map((v) => v * left);
    this.#last = goal.map((v, i) => v + this.#off[i]);
    return this.#last;
  }

  /** Nothing is shown: the next one does not glide. */
  forget() {
    this.#last = null;
  }
}

/** Swing of a hand (m/s) from its last places [{t: ms, position}]: a straight line through the last tenth of a second. */
export function swing(places, window = 100) {
  const last = places.at(-1);
  const recent = last ? places.filter(({ t }) => t >= last.t - window) : [];
  const span = recent.length > 1 ? (recent.at(-1).t - recent[0].t) / 1000 : 0;
  if (span < 0.03) return [0, 0, 0];
  return recent.at(-1).position.map((v, i) => (v - recent[0].position[i]) / span);
}

/** m/s: a throw without a swing, how much of the swing it gets, and how steeply it rises. */
const GENTLE = 2;
const OF_SWING = 1.2;
const LOFT = 1;

/** The velocity of a throw in the axes of `quat_xyzw`, in which `vertical` points up. */
export function thrown(quat_xyzw, swung, vertical) {
  const forward = turned(quat_xyzw, [0, 0, -1]);
  return forward.map((v, i) => GENTLE * v + OF_SWING * swung[i] + LOFT * vertical[i]);
}

/** Where a place is for who looks so, in words: "2 m to your left". In axes that have y up. */
export function wayTo(position, quat_xyzw, place) {
  const [dx, , dz] = place.map((v, i) => v - position[i]);
  const [fx, , fz] = turned(quat_xyzw, [0, 0, -1]);
  const metres = Math.max(1, Math.round(Math.hypot(dx, dz)));
  const left = Math.atan2(fx * -dz + fz * dx, fx * dx + fz * dz);
  const side = Math.abs(left) < Math.PI / 5 ? "ahead" : Math.abs(left) > (4 * Math.PI) / 5 ? "behind you" : left > 0 ? "to your left" : "to your right";
  return `${metres} m ${side}`;
}

/** What a player reads: {rally, best, line}; `way`: to the ball. */
export function words(score, ball, name, way = "") {
  const { rally = 0, best = 0 } = score?.data ?? {};
  if (!ball) return { rally, best, line: "The game begins when two are in place." };
  const { phase, by } = ball.data;
  if (phase === "lies") return { rally, best, line: `The ball lies on the floor${way ? `, ${way}` : ""}. Walk up to it.` };
  if (phase === "flies") return { rally, best, line: by === name ? "" : `${by} has thrown. Look at the ball${way ? `, ${way}` : ""}.` };
  return { rally, best, line: by === name ? "You have the ball. Hold, swing and let go." : `${by} has the ball.` };
}
