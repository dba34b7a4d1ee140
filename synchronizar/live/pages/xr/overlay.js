/** What stands over the camera's picture: state, progress, what to do, who is there. */

import { byId, say } from "../dom.js";
import { fillBadge } from "../view/devices.js";
import { advice, stateOf } from "../words.js";
import { wayOf } from "./cue.js";

const NOTICE_MS = 6000;

export class Overlay {
  #timer = null;
  #way = undefined;

  /** `actions`: {leave, mark}. */
  constructor(actions) {
    // In place of an earlier visit's.
    byId("leave").onclick = actions.leave;
    byId("mark").onclick = actions.mark;
    // A finger on a button takes hold of nothing behind it.
    for (const touched of [byId("leave"), byId("mark"), byId("app")]) touched.onbeforexrselect = (event) => event.preventDefault();
  }

  show(shown) {
    byId("overlay").hidden = !shown;
  }

  /** `told`: this device's frame; `others`: how many are in place; `waiting`: markers that wait for theirs. */
  update(name, told, others, waiting) {
    say(byId("me"), name);
    fillBadge(byId("state"), { told, here: true });
    const registered = stateOf(told) === "registered";
    byId("progress").hidden = registered;
    byId("progress").value = told?.progress ?? 0;
    say(byId("advice"), registered ? "" : advice(told));
    this.#arrow(registered ? null : wayOf(told?.cue));
    const seen = others === 1 ? "1 other in place" : `${others} others in place`;
    const wait = waiting ? `${waiting} marker${waiting > 1 ? "s" : ""} until the room knows where you are` : "";
    say(byId("others"), [registered ? seen : "", wait].filter(Boolean).join(" · "));
  }

  /** One sentence for some seconds. */
  notice(text) {
    say(byId("notice"), text);
    byId("notice").hidden = false;
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => (byId("notice").hidden = true), NOTICE_MS);
  }

  #arrow(way) {
    if (way === this.#way) return;
    this.#way = way;
    // SVG elements have `hidden` as an attribute only.
    byId("arrow").toggleAttribute("hidden", way === null);
    if (way !== null) byId("arrow-turn").setAttribute("transform", `rotate(${(-way * 180) / Math.PI})`);
  }
}
