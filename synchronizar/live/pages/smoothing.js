/**
 * The frame that a page shows follows the one that is solved, so slowly that no object is seen to swim.
 * The same rule as synchronizar/live/smoothing.py; both are held to tests/live/vectors/smoothing.json.
 *
 * All axes are z up. A frame ("placing") is common_from_user as {x, y, z, yaw, scale}:
 * p_common = Rz(yaw) (scale p_user) + (x, y, z). Lengths m, angles rad, times s.
 */

/** SmoothingParameters of synchronizar/parameters.py, which says what each is. */
export const SMOOTHING = Object.freeze({
  dead_band: 0.01,
  arm: 3.0,
  settled: 0.5,
  least_speed: 0.02,
  rate: 0.2,
  people: 5.0,
  out_of_view: 10.0,
  fade_beyond: 0.5,
  fade_time: 0.3,
  alarm_least: 0.1,
  alarm_sigmas: 5.0,
  alarm_memory: 10.0,
});

/** A point [x, y, z] of the user's frame (z up), in the common frame. */
export function place(placing, point) {
  const c = Math.cos(placing.yaw);
  const s = Math.sin(placing.yaw);
  const [px, py, pz] = point.map((v) => placing.scale * v);
  return [placing.x + c * px - s * py, placing.y + s * px + c * py, placing.z + pz];
}

/** Covariance (4x4 over x, y, z, yaw) at the place of the device, from that at the origin of its frame. */
export function covarianceAt(covariance, placing, at) {
  const [x, y] = place(placing, at);
  const lever = [-(y - placing.y), x - placing.x, 0, 1];
  const half = covariance.map((row) => row.map((v, j) => (j === 3 ? v : v + row[3] * lever[j])));
  return half.map((row, i) => row.map((v, j) => (i === 3 ? v : v + half[3][j] * lever[i])));
}

/** Half-axes (1 sigma) and direction (rad, of the longer one) of the ellipse of a covariance's x and y. */
export function ellipse(covariance) {
  const [[a, b], [, d]] = covariance;
  const mean = 0.5 * (a + d);
  const half = Math.hypot(0.5 * (a - d), b);
  return {
    major: Math.sqrt(Math.max(0, mean + half)),
    minor: Math.sqrt(Math.max(0, mean - half)),
    direction: 0.5 * Math.atan2(2 * b, a - d),
  };
}

/** Follows one device's frame: `solved` for each frame that is told, `step` for each frame that is drawn. */
export class Smoother {
  #solved = null;
  #covariance = null;
  #told = null;
  #following = [false, false, false];

  constructor(parameters = SMOOTHING) {
    this.parameters = parameters;
    /** 0 to 1, of everything that stands in the common frame. */
    this.opacity = 0;
    /** What is drawn with; null until a frame was solved. */
    this.shown = null;
  }

  /**
   * A registered frame was told at `t`, with its covariance; the device is `at` [x, y, z] in its own frame, z up.
   * Returns {distance, sigmas} where it contradicts what was told before (say that things have moved), else null.
   */
  solved(t, placing, covariance, at) {
    const alarm = this.#told ? alarmOf(this.#told, placing, at, this.parameters) : null;
    if (!this.#told || alarm || t - this.#told.t >= this.parameters.alarm_memory) {
      this.#told = { t, placing, covariance };
    }
    this.#solved = placing;
    this.#covariance = covariance;
    this.shown ??= placing;
    return alarm;
  }

  /** The device is not registered any more: what is shown stays, and whatever comes next contradicts nothing. */
  lost() {
    this.#told = null;
  }

  /** The device's SLAM began another frame: nothing can be shown until that one is solved. */
  forget() {
    this.shown = this.#solved = this.#told = null;
    this.opacity = 0;
    this.#following = [false, false, false];
  }

  /**
   * What to draw with, `dt` after the last time: {placing, opacity}, or null where nothing was solved yet.
   * `inView`, of the common frame on the screen: "things" that stand, or else "people", who move anyway, or "nothing".
   */
  step(dt, at, inView = "things") {
    if (!this.shown) return null;
    const p = this.parameters;
    const shown = this.shown;
    const goal = this.#solved;
    const here = place(shown, at);
    const there = place(goal, at);
    const away = there.map((v, i) => v - here[i]);
    const distance = Math.hypot(...away);
    const turn = wrap(goal.yaw - shown.yaw);
    const stretch = Math.log(goal.scale / shown.scale);
    const fading = Math.max(distance, p.arm * Math.abs(turn), p.arm * Math.abs(stretch)) > p.fade_beyond;
    const seen = inView !== "nothing";
    if (fading && seen) this.opacity -= dt / p.fade_time;
    if (fading && (!seen || this.opacity <= 0)) {
      this.opacity = Math.max(0, this.opacity);
      this.shown = goal;
      this.#following = [false, false, false];
    } else if (!fading) {
      this.opacity = Math.min(1, this.opacity + dt / p.fade_time);
      const told = covarianceAt(this.#covariance, goal, at);
      const factor = dt * { things: 1, people: p.people, nothing: p.out_of_view }[inView];
      const moved = this.#share(0, distance, ellipse(told).major, 1, factor);
      const turned = this.#share(1, Math.abs(turn), Math.sqrt(Math.max(0, told[3][3])), p.arm, factor);
      const stretched = this.#share(2, Math.abs(stretch), 0, p.arm, factor);
      const yaw = wrap(shown.yaw + turned * turn);
      const scale = shown.scale * Math.exp(stretched * stretch);
      const lever = place({ x: 0, y: 0, z: 0, yaw, scale }, at);
      const [x, y, z] = here.map((v, i) => v + moved * away[i] - lever[i]);
      this.shown = { x, y, z, yaw, scale };
    }
    return { placing: this.shown, opacity: this.opacity };
  }

  /** Which share of an error (m, or over `arm` m: rad, log) is taken back now. */
  #share(which, error, sigma, arm, factor) {
    const p = this.parameters;
    const band = this.#following[which] ? (p.settled * p.dead_band) / arm : Math.max(p.dead_band / arm, sigma);
    this.#following[which] = error > band;
    if (!this.#following[which]) return 0;
    return Math.min(1, (factor * (p.least_speed / arm + p.rate * error)) / error);
  }
}

function alarmOf(told, now, at, p) {
  const before = place(told.placing, at);
  const turn = wrap(now.yaw - told.placing.yaw);
  const change = [...place(now, at).map((v, i) => v - before[i]), turn];
  const distance = Math.hypot(...change.slice(0, 3)) + p.arm * Math.abs(turn);
  if (distance <= p.alarm_least) return null;
  // Nothing is known better than what a display can show.
  const covariance = covarianceAt(told.covariance, told.placing, at);
  for (let i = 0; i < 4; i++) covariance[i][i] += (i === 3 ? p.dead_band / p.arm : p.dead_band) ** 2;
  const sigmas = Math.sqrt(quadratic(covariance, change));
  return sigmas > p.alarm_sigmas ? { distance, sigmas } : null;
}

/** v^T A^-1 v of a positive definite A, by its Cholesky root. */
function quadratic(a, v) {
  const root = a.map((row) => row.map(() => 0));
  let sum = 0;
  const white = [];
  for (let i = 0; i < v.length; i++) {
    for (let j = 0; j <= i; j++) {
      let rest = a[i][j];
      for (let k = 0; k < j; k++) rest -= root[i][k] * root[j][k];
      root[i][j] = i === j ? Math.sqrt(rest) : rest / root[j][j];
    }
    let rest = v[i];
    for (let k = 0; k < i; k++) rest -= root[i][k] * white[k];
    white[i] = rest / root[i][i];
    sum += white[i] ** 2;
  }
  return sum;
}

/** The same angle within [-pi, pi). */
export function wrap(angle) {
  const turn = 2 * Math.PI;
  return ((((angle + Math.PI) % turn) + turn) % turn) - Math.PI;
}
