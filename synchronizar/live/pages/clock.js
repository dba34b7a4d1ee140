/** A device's clock against the room's, by ping and pong. */

/** s over which the quickest word of each way is looked for. */
const WINDOW_S = 16;

/** s for which a recording goes on though nothing more has been heard. */
const AHEAD_S = 0.2;
/** s over which its pace is measured, and no shorter ones. */
const PACE_S = 2;
const LEAST_PACE_S = 0.2;
/** s: what jumps so far is another recording's time, or the first of one. */
const ANOTHER_S = 60;

/** s, a clock that only goes forwards and goes on after a reload: what stamps poses, pings and ranges. */
export function deviceNow() {
  return (performance.timeOrigin + performance.now()) / 1000;
}

/** The stamp (s) of an XR frame's or an animation frame's time (ms). */
export function stampOf(milliseconds) {
  return (performance.timeOrigin + milliseconds) / 1000;
}

/** The lowest value of the last while. */
class Lowest {
  #kept = [];

  take(t, value) {
    if (this.#kept.length && t < this.#kept.at(-1).t) this.#kept = []; // the clock was set back
    while (this.#kept.length && this.#kept.at(-1).value >= value) this.#kept.pop();
    this.#kept.push({ t, value });
    while (this.#kept[0].t < t - WINDOW_S) this.#kept.shift();
  }

  clear() {
    this.#kept = [];
  }

  get value() {
    return this.#kept.length ? this.#kept[0].value : null;
  }
}

/** A recording's time, which goes as fast as whoever plays it lets it: by the moments of what was told. */
export class PlayedClock {
  #heard = [];
  #pace = 1;
  #last = null;

  /** Something of the moment `t` of the recording came at `now`, by the device's clock. */
  heard(t, now) {
    const before = this.#heard.at(-1);
    if (t === before?.t) return;
    // It begins: until then the room had another time.
    if (before && Math.abs(t - before.t) > ANOTHER_S) [this.#heard, this.#pace, this.#last] = [[], 1, null];
    this.#heard.push({ t, now });
    while (this.#heard.length > 2 && this.#heard[1].now < now - PACE_S) this.#heard.shift();
    // What has waited on its way comes all at once, and says nothing of the pace by itself.
    const first = this.#heard[0];
    if (now - first.now > LEAST_PACE_S) this.#pace = Math.max(0, (t - first.t) / (now - first.now));
  }

  /** The moment that it is at `now`; null before anything was heard. It never goes back. */
  at(now) {
    const newest = this.#heard.at(-1);
    if (!newest) return null;
    const ahead = Math.min(now - newest.now, AHEAD_S) * this.#pace;
    return (this.#last = Math.max(this.#last ?? -Infinity, newest.t + ahead));
  }
}

/**
 * How far the room's clock is ahead of the device's: what the room says bounds it from below, what it has answered from
 * above; the middle is right where the quickest of both ways are alike. As in synchronizar/live/round_trips.py.
 */
export class ClockOffset {
  #lower = new Lowest();
  #upper = new Lowest();

  /** A pong that answers a ping of `t` came at `now`, both by the device's clock; `room_t` by the room's. */
  hear({ t, room_t }, now) {
    if (this.#lower.value !== null && room_t - t < -this.#lower.value) this.#lower.clear();
    this.heard(room_t, now);
    this.#upper.take(now, room_t - t);
  }

  /** A word that the room said at `room_t`, by its clock, came at `now`, by the device's. */
  heard(room_t, now) {
    this.#lower.take(now, now - room_t);
    // Bounds that contradict each other: the clock stood still meanwhile, or was set.
    if (this.#upper.value !== null && this.#upper.value < room_t - now) this.#upper.clear();
  }

  /** {offset, roundTrip} in s, or null before the first pong. */
  get best() {
    const [upper, lower] = [this.#upper.value, this.#lower.value];
    if (upper === null || lower === null) return null;
    return { offset: 0.5 * (upper - lower), roundTrip: upper + lower };
  }

  /** Forget: another connection. */
  clear() {
    this.#lower.clear();
    this.#upper.clear();
  }
}
