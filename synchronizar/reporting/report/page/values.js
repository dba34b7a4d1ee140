// The report's data, read once: times in s since the first range, lengths in m, angles in rad.

export const values = JSON.parse(document.getElementById("data").textContent);
export const USED = 0;
export const UNUSABLE = 2;

const HELD_S = 0.5;
const thousandth = (x) => (x === null ? NaN : x / 1000);
const metres = (column) => Float64Array.from(column, thousandth);

export const users = values.users.map((user, index) => ({
  ...user,
  index,
  track: user.track && Object.fromEntries(Object.entries(user.track).map(([of, column]) => [of, metres(column)])),
  others: user.others.map((walk) => walk.map((place) => place.map(thousandth))),
  jumps: user.jumps.map((jump) => ({ ...jump, user: index, t: thousandth(jump.t), place: jump.place?.map(thousandth) })),
  history: user.history && {
    states: user.history.states.map(([t, state]) => [thousandth(t), state]),
    cues: user.history.cues.map(([t, cue]) => [thousandth(t), cue]),
    progress: metres(user.history.progress),
    sigma: metres(user.history.sigma),
    yawSigma: metres(user.history.yaw_sigma),
  },
}));
let walkers = 0;
for (const user of users) {
  user.look = user.static ? { colour: 9, dashes: 0 } : { colour: walkers % 9, dashes: Math.floor(walkers / 9) % 3 };
  if (!user.static) walkers += 1;
  user.gap = user.track ? longestGap(user.track.t) : 0;
}

export const updates = values.updates && metres(values.updates);
export const events = values.events.map(([t, text]) => [thousandth(t), text]);
export const jumps = users.flatMap((user) => user.jumps).sort((a, b) => a.t - b.t);

const columns = values.ranges;
export const ranges = {
  count: columns.t.length,
  t: metres(columns.t),
  a: columns.a,
  b: columns.b,
  distance: metres(columns.distance),
  residual: metres(columns.residual),
  verdict: columns.verdict,
};

export const pairs = new Map(values.pairs.map((pair) => [pairKey(pair.a, pair.b), pair]));

export function pairKey(a, b) {
  return Math.min(a, b) * users.length + Math.max(a, b);
}

// s: when the last pose or range was.
export const end = Math.max(
  1e-3,
  ...users.filter((user) => user.track && !user.static).map((user) => user.track.t.at(-1)),
  ranges.count ? ranges.t[ranges.count - 1] : 0,
);

// Longest time between two poses that is bridged: a second, or a few poses where many are left out.
function longestGap(t) {
  const steps = Array.from(t.subarray(1), (later, n) => later - t[n]).sort((a, b) => a - b);
  return Math.max(1.0, 3 * (steps[steps.length >> 1] ?? 0));
}

// Index of the first number of a rising column that is not below x.
export function firstFrom(column, x) {
  let [low, high] = [0, column.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (column[middle] < x) low = middle + 1;
    else high = middle;
  }
  return low;
}

// Where a device was: {x, y, z}, or null where that is not known. The first and the last pose hold for half a second.
export function placeAt(user, t) {
  const track = user.track;
  if (!track) return null;
  if (user.static) return { x: track.x[0], y: track.y[0], z: track.z[0] };
  const last = track.t.length - 1;
  if (t < track.t[0] - HELD_S || t > track.t[last] + HELD_S) return null;
  const after = Math.min(Math.max(firstFrom(track.t, t), Math.min(1, last)), last);
  const before = Math.max(after - 1, 0);
  const step = track.t[after] - track.t[before];
  if (step > user.gap && t !== track.t[after]) return null;
  const share = step > 0 ? Math.min(Math.max((t - track.t[before]) / step, 0), 1) : 0;
  const between = (column) => column[before] + share * (column[after] - column[before]);
  return { x: between(track.x), y: between(track.y), z: between(track.z) };
}

// State of a device at a time: as a replay told it, or that of the whole walk.
export function stateAt(user, t) {
  if (!user.history) return user.state;
  let now = user.history.states[0]?.[1] ?? user.state;
  for (const [since, state] of user.history.states) if (since <= t) now = state;
  return now;
}

// Which of seven classes a residual is in, by how many sigma it is off: 0 far too short, 6 far too long.
export function classOf(residual) {
  const off = residual / values.sigma;
  return off < -3 ? 0 : off < -2 ? 1 : off < -1 ? 2 : off <= 1 ? 3 : off <= 2 ? 4 : off <= 3 ? 5 : 6;
}

// What was known at a time of a value that was told at the updates.
export function historyAt(column, t) {
  const after = firstFrom(updates, t + 1e-9);
  return after > 0 ? column[after - 1] : NaN;
}
