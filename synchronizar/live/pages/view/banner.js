/** What went wrong, in a sentence with a way on. */

import { say } from "../dom.js";

export class Banner {
  #box;
  #text;
  #button;
  #way = null;

  constructor(box) {
    this.#box = box;
    this.#text = box.querySelector("p");
    this.#button = box.querySelector("button");
    this.#button.addEventListener("click", () => this.#way?.());
  }

  /** `way`: {label, go} of a button; `kind`: "note", "wait" or "error". */
  show(text, kind = "note", way = null) {
    this.#box.hidden = false;
    this.#box.dataset.kind = kind;
    say(this.#text, text);
    this.#way = way?.go ?? null;
    this.#button.hidden = !way;
    if (way) say(this.#button, way.label);
  }

  hide() {
    this.#box.hidden = true;
  }
}
