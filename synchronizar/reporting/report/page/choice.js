// What is looked at: the moment, how much of the ranges, and whom. Drawings listen.

import { end, ranges } from "./values.js";

// s: how many of the last ranges the map can be asked for; at first as many as can be told apart.
const SPANS = [0.1, 0.5, 2, 10];
const FEW = 150;
const rate = ranges.count / end;

export const choice = { t: end, span: SPANS.findLast((span) => span * rate <= FEW) ?? SPANS[0], trails: true, rejected: true, user: null, pair: null };
const listeners = [];
let changed = null;

export function onChoice(listener) {
  listeners.push(listener);
}

// Everybody is told once before the next frame, with the names of all that changed.
export function choose(change) {
  if (changed === null) {
    changed = new Set();
    requestAnimationFrame(() => {
      const told = changed;
      changed = null;
      for (const listener of listeners) listener(told);
    });
  }
  for (const [of, value] of Object.entries(change)) {
    choice[of] = of === "t" ? Math.min(Math.max(value, 0), end) : value;
    changed.add(of);
  }
}

export const toggleUser = (index) => choose({ user: choice.user === index ? null : index, pair: null });

export function togglePair(a, b) {
  const same = choice.pair && choice.pair.includes(a) && choice.pair.includes(b);
  choose({ pair: same ? null : [a, b], user: null });
}

// Whether a range of these two is among those that were asked for.
export function isChosen(a, b) {
  if (choice.pair) return choice.pair.includes(a) && choice.pair.includes(b);
  return choice.user === null || choice.user === a || choice.user === b;
}

export const isFaded = (index) =>
  choice.pair ? !choice.pair.includes(index) : choice.user !== null && choice.user !== index;
