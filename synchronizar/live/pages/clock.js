/** A device's clock against the room's, by ping and pong. */

const KEPT = 8;

/** s, a clock that only goes forwards and goes on after a reload: what stamps poses, pings and ranges. */
export function deviceNow() {
  return (performance.timeOrigin + performance.now()) / 1000;
}

/** The stamp (s) of an XR frame's or an animation frame's time (ms). */
export function stampOf(milliseconds) {
  return (performance.timeOrigin + milliseconds) / 1000;
}

/** How far the room's clock is ahead of the device's, from the quickest of the latest pings. */
export class ClockOffset {
  #pongs = [];

  /** A pong that answers a ping of `t` came at `now`, both by the device's clock; `room_t` by the room's. */
  hear({ t, room_t }, now) {
    this.#pongs.push({ roundTrip: now - t, offset: room_t - 0.5 * (t + now) });
    if (this.#pongs.length > KEPT) this.#pongs.shift();
  }

  /** {offset, roundTrip} in s, or null before the first pong. */
  get best() {
    if (!this.#pongs.length) return null;
    return this.#pongs.reduce((a, b) => (b.roundTrip < a.roundTrip ? b : a));
  }

  /** Forget: another connection. */
  clear() {
    this.#pongs = [];
  }
}
