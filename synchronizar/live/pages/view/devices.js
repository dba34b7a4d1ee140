/** A card for each device: who it is, how it stands, what to do. */

import { element, keep, say, swatch } from "../dom.js";
import { STATES, advice, metres, stateOf } from "../words.js";
import { colourOf } from "./colours.js";

export class Devices {
  #list;
  #empty;

  constructor(list, empty) {
    this.#list = list;
    this.#empty = empty;
  }

  update(users) {
    this.#empty.hidden = users.length > 0;
    keep(this.#list, users, (user) => user.index, card, fill);
  }
}

/** The badge of a state: colour, sign and word. */
export function badge() {
  return element("span", { class: "badge" });
}

export function fillBadge(target, user) {
  const state = user.here ? stateOf(user.told) : "away";
  const { sign, label, meaning } = STATES[state] ?? { sign: "○", label: "away", meaning: "Its connection is down." };
  target.dataset.state = state;
  target.title = user.told?.reason || meaning;
  say(target, `${sign} ${label}`);
}

function card() {
  const name = element("span", { class: "name" });
  const made = element(
    "li",
    { class: "card" },
    element("div", { class: "card-head" }, swatch("currentColor"), name, badge()),
    element("progress", { max: "1", value: "0" }),
    element("p", { class: "advice" }),
  );
  return made;
}

function fill(made, user) {
  const { told, here } = user;
  const colour = colourOf(user.index);
  const shape = made.querySelector(".swatch path");
  if (shape.getAttribute("fill") !== colour) shape.setAttribute("fill", colour);
  say(made.querySelector(".name"), user.name);
  fillBadge(made.querySelector(".badge"), user);
  const progress = made.querySelector("progress");
  const registered = stateOf(told) === "registered";
  const share = registered ? 1 : Math.min(0.99, told?.progress ?? 0);
  progress.value = share;
  progress.hidden = share >= 1 || user.static;
  progress.setAttribute("aria-label", `how far ${user.name} is`);
  const known = registered ? `Known to ${metres(told.sigma)}.` : advice(told);
  say(made.querySelector(".advice"), here ? known : "Its connection is down. It comes back as the same device.");
  made.classList.toggle("away", !here);
}
