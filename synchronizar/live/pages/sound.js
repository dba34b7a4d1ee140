/** Short sounds that are made here, so that nothing has to be fetched; whoever wants none turns them off for good. */

const KEY = "synchronizar-sound";

export class Sound {
  #context = null;

  /** Whether anything is heard. */
  get on() {
    try {
      return localStorage.getItem(KEY) !== "off";
    } catch {
      return true;
    }
  }

  set on(on) {
    try {
      localStorage.setItem(KEY, on ? "on" : "off");
    } catch {
      // A browser that keeps nothing asks again the next time.
    }
  }

  /** Notes one after the other: [{hz, to, s, volume, shape}]; `to`: the pitch at its end. */
  play(notes) {
    if (!this.on || typeof AudioContext === "undefined") return;
    // No browser lets a page be heard that nobody has touched yet.
    if (navigator.userActivation?.hasBeenActive === false) return;
    this.#context ??= new AudioContext();
    this.#context.resume();
    let at = this.#context.currentTime;
    for (const { hz, to = hz, s = 0.1, volume = 0.15, shape = "sine" } of notes) {
      const tone = new OscillatorNode(this.#context, { type: shape, frequency: hz });
      const gain = new GainNode(this.#context, { gain: volume });
      tone.frequency.exponentialRampToValueAtTime(to, at + s);
      gain.gain.setValueAtTime(volume, at);
      gain.gain.exponentialRampToValueAtTime(0.001, at + s);
      tone.connect(gain).connect(this.#context.destination);
      tone.start(at);
      tone.stop(at + s);
      at += 0.8 * s;
    }
  }

  /** A button that turns it on and off. */
  button() {
    const made = document.createElement("button");
    made.type = "button";
    made.className = "sound";
    const show = () => {
      made.textContent = this.on ? "Sound on" : "Sound off";
      made.setAttribute("aria-pressed", String(this.on));
    };
    made.addEventListener("click", () => {
      this.on = !this.on;
      show();
    });
    show();
    return made;
  }
}
