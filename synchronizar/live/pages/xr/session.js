/** An AR session: its start, its poses, its hands and anchors, and what its SLAM says of itself. */

/** s without a pose after which SLAM is taken to have lost track. */
const LOST_S = 0.5;
/** How depth is asked for: to be read by the page. */
const DEPTH = { usagePreference: ["cpu-optimized"], dataFormatPreference: ["luminance-alpha", "float32"] };
/** A second: poses that are sent, at most. */
const MOST_POSES = 62;

export class ArSession extends EventTarget {
  #session = null;
  #space = null;
  #seenAt = null;
  #sentAt = -Infinity;
  #lost = false;
  #hands = new Set();
  #asked = [];
  #anchors = new Set();
  #canAnchor = true;

  /** Whether it runs. */
  get running() {
    return this.#session !== null;
  }

  /**
   * Ask for a session, from within a click. `overlay`: an element that stays on top where the browser can do that;
   * `features`: of WebXR, what is wanted besides, as far as the device has it. Throws what the browser throws. Events: `pose` ({t, position, quat_xyzw}: axes of WebXR, t in ms by the page's
   * clock), `reset` (another frame from now on), `lost`, `found`, `selectstart`, `selectend`, `end`; and of hands, which
   * are fingers on the screen and controllers, `take`, `hold` with each frame, and `let` ({hand, t, position, quat_xyzw}:
   * of its ray, along its -z).
   */
  async start(renderer, overlay, draw, features = []) {
    const wanted = {
      requiredFeatures: ["local"],
      optionalFeatures: ["dom-overlay", "anchors", ...features],
      domOverlay: { root: overlay },
    };
    if (features.includes("depth-sensing")) wanted.depthSensing = DEPTH;
    const session = await navigator.xr.requestSession("immersive-ar", wanted);
    this.#session = session;
    // A touch beside the overlay's buttons, or a headset's trigger.
    for (const type of ["selectstart", "selectend"]) {
      session.addEventListener(type, () => this.dispatchEvent(new CustomEvent(type)));
    }
    for (const kind of ["select", "squeeze"]) {
      session.addEventListener(`${kind}start`, ({ frame, inputSource }) => {
        if (!frame || !inputSource) return;
        this.#hands.add(inputSource);
        this.#hand("take", frame, inputSource);
      });
      session.addEventListener(`${kind}end`, ({ inputSource }) => this.#open(inputSource));
    }
    session.addEventListener("end", () => {
      for (const hand of this.#hands) this.#open(hand);
      for (const { resolve } of this.#asked.splice(0)) resolve(null);
      this.#anchors.clear();
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
      this.#follow(frame);
      for (const hand of this.#hands) this.#hand("hold", frame, hand, time);
      draw(time, frame, this.#space);
    });
  }

  end() {
    return this.#session?.end();
  }

  /**
   * An anchor at a place of the device's own frame: {position, end}, `position` kept up, null while SLAM does not see it.
   * Null where the device has no anchors.
   */
  anchorAt(position) {
    if (!this.running || !this.#canAnchor) return Promise.resolve(null);
    return new Promise((resolve) => this.#asked.push({ position, resolve }));
  }

  /** Anchors are made within a frame, and asked with each where they are. */
  #follow(frame) {
    this.#canAnchor &&= typeof frame.createAnchor === "function";
    for (const { position, resolve } of this.#asked.splice(0)) {
      if (this.#canAnchor) this.#anchor(frame, position).then(resolve);
      else resolve(null);
    }
    for (const anchor of this.#anchors) {
      const p = frame.getPose(anchor.space, this.#space)?.transform.position;
      anchor.position = p ? [p.x, p.y, p.z] : null;
    }
  }

  async #anchor(frame, [x, y, z]) {
    try {
      const made = await frame.createAnchor(new XRRigidTransform({ x, y, z }), this.#space);
      const anchor = { space: made.anchorSpace, position: null };
      anchor.end = () => {
        this.#anchors.delete(anchor);
        made.delete();
      };
      this.#anchors.add(anchor);
      return anchor;
    } catch (error) {
      // Without the feature it is never given one; at another time SLAM may just not see the place.
      if (error.name === "NotSupportedError") this.#canAnchor = false;
      return null;
    }
  }

  #hand(type, frame, hand, t = performance.now()) {
    const pose = frame.getPose(hand.targetRaySpace, this.#space);
    if (!pose) return;
    const { position: p, orientation: q } = pose.transform;
    const detail = { hand, t, position: [p.x, p.y, p.z], quat_xyzw: [q.x, q.y, q.z, q.w] };
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }

  #open(hand) {
    this.#hands.delete(hand);
    this.dispatchEvent(new CustomEvent("let", { detail: { hand } }));
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
