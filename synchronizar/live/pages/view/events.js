/** What happened, newest first; a screen reader reads each once. */

import { element, keep } from "../dom.js";

const SHOWN = 60;

export class EventLog {
  #list;
  #count = 0;

  constructor(list) {
    this.#list = list;
  }

  /** Events newest last: {t, text}; `elapsed(t)` says when that was. */
  update(events, elapsed) {
    for (const event of events) event.key ??= this.#count++;
    const newest = events.slice(-SHOWN).reverse();
    const make = ({ t, text }) =>
      element("li", {}, element("time", { text: elapsed(t) }), element("span", { text }));
    keep(this.#list, newest, ({ key }) => key, make, () => {});
  }
}
