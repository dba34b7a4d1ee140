/** An AR session: its start, its poses, and what its SLAM says of itself. */

/** s without a pose after which SLAM is taken to have lost track. */
const LOST_S = 0.5;
/** A second: poses that are sent, at most. */
const MOST_POSES = 62;

export class ArSession extends EventTarget {
  #session = null;
  #space = null;
  #seenAt = null;
  #sentAt = -Infinity;
  #lost = false;

  /** Whether it runs. */
  get running() {
    return this.#session !== null;
  }

  /**
   * Ask for a session, from within a click. `overlay`: an element that stays on top where the browser can do that.
   * Throws what the browser throws. Events: `pose` ({t, position, quat_xyzw}: axes of WebXR, t in ms by the page's
   * clock), `reset` (another frame from now on), `lost`, `found`, `selectstart`, `selectend`, `end`.
   */
  async start(renderer, overlay, draw) {
    const session = await navigator.xr.requestSession("immersive-ar", {
      requiredFeatures: ["local"],
      optionalFeatures: ["dom-overlay"],
      domOverlay: { root: overlay },
    });
    this.#session = session;
    // A touch beside the overlay's buttons, or a headset's trigger.
    for (const type of ["selectstart", "selectend"]) {
      session.addEventListener(type, () => this.dispatchEvent(new CustomEvent(type)));
    }
    session.addEventListener("end", () => {
      renderer.setAnimationLoop(null);
      this.#session = this.#space = null;
      this.dispatchEvent(new CustomEvent("end"));
    });
    await renderer.xr.setSession(session);
    this.#space = renderer.xr.getReferenceSpace();
    this.#space.addEventListener("reset", () => this.dispatchEvent(new CustomEvent("reset")));
    renderer.setAnimationLoop((time, frame) => {
      // three.js may keep the page's own loop going beside the session's; that one has no frame.
      if (!frame) return;
      this.#pose(time, frame);
      draw(time);
    });
  }

  end() {
    return this.#session?.end();
  }

  #pose(time, frame) {
    const pose = frame.getViewerPose(this.#space);
    if (!pose || pose.emulatedPosition) {
      if (!this.#lost && this.#seenAt !== null && time - this.#seenAt > 1000 * LOST_S) this.#become(true);
      return;
    }
    this.#seenAt = time;
    if (this.#lost) this.#become(false);
    if (time - this.#sentAt < 1000 / MOST_POSES) return;
    this.#sentAt = time;
    const { position: p, orientation: q } = pose.transform;
    const detail = { t: time, position: [p.x, p.y, p.z], quat_xyzw: [q.x, q.y, q.z, q.w] };
    this.dispatchEvent(new CustomEvent("pose", { detail }));
  }

  #become(lost) {
    this.#lost = lost;
    this.dispatchEvent(new CustomEvent(lost ? "lost" : "found"));
  }
}
