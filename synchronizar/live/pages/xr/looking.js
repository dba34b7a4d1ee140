/** On a phone: through whose eyes one looks, and who looks through one's own. The room's application hands out consent. */

import { element, keep, say } from "../dom.js";
import { lookers, others } from "../looks.js";
import { EVERY_S, Gallery, still } from "../stills.js";
import { Streams } from "../streams.js";
import { Screen } from "./screen.js";

/** Half the height (m) at 1 m of a view of which nothing is told: 50 degrees. */
const USUAL_HALF = 0.47;

export class Looking {
  #place;
  #gallery = new Gallery();
  #streams;
  #screens = new Map();
  #since = 0;
  #list = element("ul", { class: "app-list" });
  #asked = element("ul", { class: "app-list", role: "status" });
  #heard;

  /** `place`: what the phone's page has, see docs/apps.md. */
  constructor(place) {
    this.#place = place;
    this.#streams = new Streams(place.client);
    const folded = element("details", {}, element("summary", { text: "See through somebody's eyes" }), this.#list);
    place.panel.append(this.#asked, folded);
    this.#heard = ({ detail: { topic, data, by } }) => topic === "eye" && this.#gallery.hear(by, data, performance.now() / 1000);
    place.client.addEventListener("said", this.#heard);
  }

  /** Where screens are drawn, in the common frame, by the names of those whose they are. */
  get places() {
    const shown = [...this.#screens].filter(([, { root }]) => root.visible);
    return Object.fromEntries(shown.map(([name, { root }]) => [name, root.position.toArray()]));
  }

  /** With each frame. */
  update(dt) {
    const { client, name } = this.#place;
    this.#words(client, name);
    this.#show(dt, client, name);
    this.#look(client, name);
  }

  end() {
    const { client, common } = this.#place;
    client.removeEventListener("said", this.#heard);
    this.#streams.end();
    for (const { root } of this.#screens.values()) common.remove(root);
  }

  /** What one sees goes to those who may see it, and to nobody else. */
  #show(dt, client, name) {
    const on = lookers(client, name).filter((look) => look.on).map(({ who }) => who);
    this.#since += dt;
    const { picture } = this.#place;
    if (on.length && this.#since >= EVERY_S) {
      this.#since = 0;
      const taken = still(picture.canvas, picture.take());
      const rest = on.filter((who) => who === "" || !this.#streams.reaches(who));
      if (taken) for (const who of rest) client.say("eye", taken, who || null);
    }
    this.#streams.showTo(on.filter((who) => who !== ""), picture.canvas);
  }

  /** Screens of those through whose eyes one looks. */
  #look(client, name) {
    const { avatars, common } = this.#place;
    const seen = new Set(others(client, name).filter(({ state }) => state === "on").map(({ whom }) => whom));
    for (const [whom, screen] of this.#screens) {
      if (seen.has(whom)) continue;
      common.remove(screen.root);
      screen.dispose();
      this.#screens.delete(whom);
      this.#gallery.drop(whom);
      this.#streams.drop(whom);
    }
    for (const whom of seen) {
      if (!this.#screens.has(whom)) {
        this.#screens.set(whom, new Screen());
        common.add(this.#screens.get(whom).root);
      }
      const screen = this.#screens.get(whom);
      const still = this.#gallery.of(whom, performance.now() / 1000);
      const video = this.#streams.of(whom);
      if (video || still) {
        const aspect = still?.aspect ?? video.videoWidth / video.videoHeight;
        screen.show(video ?? still.image, still?.half ?? USUAL_HALF, aspect);
      }
      screen.place(video || still ? avatars.placeOf(whom) : null, client.member(whom)?.up);
    }
  }

  #words(client, name) {
    const answer = (topic, who) => client.say(topic, topic === "stop" ? { who, whom: name } : { who }, "app");
    keep(
      this.#asked,
      lookers(client, name),
      ({ who, on }) => `${on} ${who}`,
      ({ who, on, line }) => {
        const words = on ? [["Stop", "stop"]] : [["Yes", "allow"], ["No", "refuse"]];
        const buttons = words.map(([text, topic]) => button(text, () => answer(topic, who)));
        return element("li", { class: on ? "seen" : null }, element("span", { text: line }), ...buttons);
      },
      () => {},
    );
    keep(this.#list, others(client, name), entryKey, (item) => entry(client, name, item), sayLine);
  }
}

/** For a list of those whose eyes may be asked for: a key, an element, what changes of it. */
export function entryKey({ whom, state }) {
  return `${state} ${whom}`;
}

export function entry(client, who, { whom, line, act, button: text }) {
  const data = act === "stop" ? { who, whom } : { whom };
  const go = act ? [button(text, () => client.say(act, data, "app"))] : [];
  return element("li", {}, element("span", { text: line }), ...go);
}

export function sayLine(item, { line }) {
  say(item.firstChild, line);
}

function button(text, act) {
  const made = element("button", { type: "button", text });
  made.addEventListener("click", act);
  return made;
}
