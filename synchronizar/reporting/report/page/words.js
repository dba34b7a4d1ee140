// Figures in words: what is told of a range, a jump, a pair, a device.

import { UNUSABLE, pairKey, pairs, ranges, stateAt, users, values } from "./values.js";

export const number = (x, digits, signed = false) =>
  x === null || x === undefined || Number.isNaN(x)
    ? "–"
    : `${signed && x >= 0 ? "+" : ""}${x.toFixed(digits)}`.replace(/^-(?=[0.]*$)/, "").replace("-", "−");
export const degrees = (x, digits = 1, signed = false) => number(x === null ? null : (x * 180) / Math.PI, digits, signed);
const VERDICTS = ["used", "rejected", "unusable"];

export function rangeWords(row) {
  const [a, b] = [users[ranges.a[row]].name, users[ranges.b[row]].name];
  const lines = [`${a} – ${b} at ${number(ranges.t[row], 2)} s: ${VERDICTS[ranges.verdict[row]]}`];
  lines.push(`measured ${number(ranges.distance[row], 3)} m`);
  if (ranges.verdict[row] !== UNUSABLE) {
    const off = ranges.residual[row];
    lines[1] += `, expected ${number(ranges.distance[row] - off, 3)} m`;
    lines.push(`residual ${number(off, 3, true)} m, ${number(off / values.sigma, 1, true)} σ`);
  }
  return lines.join("\n");
}

export function jumpWords(jump) {
  return [
    `${users[jump.user].name}: SLAM jumped at ${number(jump.t, 2)} s`,
    `by ${number(jump.distance, 2)} m, ${degrees(jump.turn, 1, true)}° about the vertical`,
    `tilt ${degrees(jump.tilt, 1)}°`,
  ].join("\n");
}

export function pairWords(a, b) {
  const pair = pairs.get(pairKey(a, b));
  const names = `${users[a].name} – ${users[b].name}`;
  if (!pair) return `${names}: never ranged`;
  const all = pair.used + pair.rejected + pair.unusable;
  return [
    `${names}: ${all} ranges, median ${number(pair.distance, 2)} m`,
    `${pair.used} used, ${pair.rejected} rejected, ${pair.unusable} unusable`,
    pair.used
      ? `residuals: RMS ${number(pair.rms, 3)} m, mean ${number(pair.mean, 3, true)} m, worst ${number(pair.worst, 2, true)} m`
      : "none was used",
  ].join("\n");
}

export function userWords(user, t, place) {
  const lines = [`${user.name}: ${values.states[stateAt(user, t)]}`];
  if (place) lines.push(`x ${number(place.x, 2)}, y ${number(place.y, 2)}, z ${number(place.z, 2)} m, at ${number(t, 1)} s`);
  if (!user.history) lines.push(user.reason);
  return lines.join("\n");
}
