/** Where the common frame is shown on this device: what the room tells of it, smoothed. */

import { placingOf, zUpFromYUp } from "../axes.js";
import { Smoother } from "../smoothing.js";

export class OwnFrame extends EventTarget {
  #client;
  #smoother = new Smoother();
  #at = [0, 0, 0];

  /** Events: `moved` ({distance, sigmas}: a correction larger than what was told). */
  constructor(client) {
    super();
    this.#client = client;
    this.told = null;
    this.opacity = 0;
    /** Where the common frame is drawn now, or null. */
    this.placing = null;
    client.addEventListener("welcome", ({ detail }) => this.#take(detail.frames));
    client.addEventListener("frames", ({ detail }) => this.#take(detail));
  }

  /** Whether the room knows where this device is. */
  get registered() {
    return this.told?.state === "registered" && placingOf(this.told) !== null;
  }

  /** The device is there now, in its own frame (y up). */
  moveTo(position) {
    this.#at = zUpFromYUp(position);
  }

  /** SLAM began another frame. */
  forget() {
    this.#smoother.forget();
    this.told = null;
  }

  /** The placing to draw with, or null, `dt` s after the last time. */
  step(dt, inView) {
    const shown = this.#smoother.step(dt, this.#at, inView);
    // Without a place that can be relied on, things stay where they were, and pale.
    this.opacity = shown === null ? 0 : shown.opacity * (this.registered ? 1 : 0.35);
    this.placing = shown?.placing ?? null;
    return this.placing;
  }

  #take({ t, users }) {
    const member = this.#client.member(this.#client.you[0]);
    const frame = users[member?.name] ?? null;
    this.told = frame !== null && frame.frame === member.frame ? frame : null;
    const placing = placingOf(this.told);
    if (!this.registered || this.told.covariance === null) {
      this.#smoother.lost();
      return;
    }
    const alarm = this.#smoother.solved(t, placing, this.told.covariance, this.#at);
    if (alarm) this.dispatchEvent(new CustomEvent("moved", { detail: alarm }));
  }
}
