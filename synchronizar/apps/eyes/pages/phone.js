/** Eyes on a phone: whose one sees, who sees through one's own, the surroundings that are scanned, marks, a miniature. */

import { Group } from "../../pages/vendor/three/three.module.min.js";

import { commonAttitude, commonFromDevice, turned } from "../../pages/axes.js";
import { element, keep, say } from "../../pages/dom.js";
import { Streams } from "../../pages/streams.js";
import { Cloud } from "./cloud.js";
import { LOOK, MARK, SCAN, lookers, others } from "./looks.js";
import { Marks } from "./marks.js";
import { Scanner } from "./scanner.js";
import { Screen } from "./screen.js";
import { EVERY_S, Gallery, still } from "./stills.js";
import { Model, Sightings, onFloor } from "./voxels.js";

export const features = ["mesh-detection", "depth-sensing", "camera-access"];
/** s between two words of what was scanned. */
const TOLD_EVERY_S = 1;
/** The miniature: so much smaller, and where it stands: m ahead and below. */
const SMALLER = 1 / 16;
const [AHEAD_M, BELOW_M] = [0.7, 0.35];
/** m ahead, where nothing is that one could point at. */
const IN_THE_AIR_M = 1.5;

/** `place`: what the phone's page has, see docs/apps.md. */
export function begin(place) {
  return new Layer(place);
}

class Layer {
  #place;
  #model = new Model();
  #cloud = new Cloud();
  #small = new Cloud(SMALLER);
  #table = new Group();
  #marks = new Marks();
  #gallery = new Gallery();
  #streams;
  #screens = new Map();
  #scanner = new Scanner();
  #sightings = new Sightings();
  #since = { still: 0, told: 0 };
  #list = element("ul", { class: "app-list" });
  #folded = element("details", {}, element("summary", { text: "See through somebody's eyes" }), this.#list);
  #asked = element("ul", { class: "app-list", role: "status" });
  #buttons = element("div", { class: "app-row" });
  #heard;

  constructor(place) {
    this.#place = place;
    this.kinds = new Set([LOOK, SCAN, MARK]);
    this.#streams = new Streams(place.client);
    this.#cloud.root.visible = this.#table.visible = false;
    this.#table.scale.setScalar(SMALLER);
    this.#table.add(this.#small.root);
    place.common.add(this.#cloud.root, this.#marks.root, this.#table);
    this.#button("Point at this", () => this.#point());
    this.#button("Show the model", () => (this.#cloud.root.visible = !this.#cloud.root.visible));
    this.#button("Model on a table", () => this.#putOnTable());
    place.panel.append(this.#asked, this.#folded, this.#buttons);
    this.#heard = ({ detail: { topic, data, by } }) => topic === "eye" && this.#gallery.hear(by, data, performance.now() / 1000);
    place.client.addEventListener("said", this.#heard);
  }

  /** Where marks and screens are drawn, in the common frame; for tests. */
  get places() {
    const screens = [...this.#screens].filter(([, { root }]) => root.visible);
    return { ...this.#marks.places, ...Object.fromEntries(screens.map(([name, { root }]) => [name, root.position.toArray()])) };
  }

  frame(frame, space, time) {
    const { registered, frame: own } = this.#place;
    if (!registered() || !own.placing) return;
    const common = (p) => commonFromDevice(own.placing, p);
    this.#scanner.scan(
      frame,
      space,
      time,
      (p) => this.#sightings.add(common(p), time / 1000),
      (...corners) => this.#sightings.addTriangle(...corners.map(common), time / 1000),
    );
  }

  update(dt) {
    const { client, name, registered } = this.#place;
    this.#cloud.update(client, this.#model);
    if (this.#table.visible) this.#small.update(client, this.#model);
    this.#marks.update(client);
    this.#words(client, name);
    this.#buttons.hidden = !registered();
    this.#show(dt, client, name);
    this.#look(client, name);
    this.#since.told += dt;
    if (this.#since.told < TOLD_EVERY_S) return;
    this.#since.told = 0;
    if (!registered()) this.#sightings.clear();
    const seen = this.#sightings.take();
    if (seen) client.say("seen", seen, "app");
  }

  select = { start: () => {}, end: () => this.#point() };

  end() {
    const { client, common, panel } = this.#place;
    client.removeEventListener("said", this.#heard);
    this.#streams.end();
    common.remove(this.#cloud.root, this.#marks.root, this.#table, ...[...this.#screens.values()].map(({ root }) => root));
    this.#cloud.dispose();
    this.#small.dispose();
    panel.replaceChildren();
  }

  /** What one sees goes to those who may see it, and to nobody else. */
  #show(dt, client, name) {
    const on = lookers(client, name).filter((look) => look.on).map(({ who }) => who);
    this.#since.still += dt;
    const { picture } = this.#place;
    if (on.length && this.#since.still >= EVERY_S) {
      this.#since.still = 0;
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
      if (video || still) screen.show(video ?? still.image, still?.half ?? 0.47, still?.aspect ?? video.videoWidth / video.videoHeight);
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
    keep(
      this.#list,
      others(client, name),
      ({ whom, state }) => `${state} ${whom}`,
      ({ whom, line, act, button: text }) => {
        const data = act === "stop" ? { who: name, whom } : { whom };
        const go = act ? [button(text, () => client.say(act, data, "app"))] : [];
        return element("li", {}, element("span", { text: line }), ...go);
      },
      (item, { line }) => say(item.firstChild, line),
    );
  }

  /** What the middle of the picture shows: in the model, else on the floor, else in the air. */
  #point() {
    const at = this.#eye();
    if (!at) return;
    const { position, way } = at;
    const air = position.map((v, i) => v + IN_THE_AIR_M * way[i]);
    const hit = this.#model.hit(position, way) ?? onFloor(position, way, this.#model.floor) ?? air;
    this.#place.client.say("mark", { position: hit }, "app");
  }

  /** The room's model, small, in front of the device; once more takes it away. */
  #putOnTable() {
    const at = this.#eye();
    if (!at || this.#table.visible) {
      this.#table.visible = false;
      return;
    }
    const { position: [x, y, z], way: [dx, dy] } = at;
    const flat = Math.hypot(dx, dy) || 1;
    // Where one stands in it is in the middle of the table, its floor the top of it.
    const middle = [x + (AHEAD_M * dx) / flat - SMALLER * x, y + (AHEAD_M * dy) / flat - SMALLER * y];
    this.#table.position.set(...middle, z - BELOW_M - SMALLER * this.#model.floor);
    this.#table.visible = true;
  }

  /** {position, way} of the device in the common frame; null where it is not known. */
  #eye() {
    const { own, frame, registered } = this.#place;
    const pose = own();
    if (!pose || !registered() || !frame.placing) return null;
    const way = turned(commonAttitude(frame.placing, pose.quat_xyzw), [0, 0, -1]);
    return { position: commonFromDevice(frame.placing, pose.position), way };
  }

  #button(text, act) {
    this.#buttons.append(button(text, act));
  }
}

function button(text, act) {
  const made = element("button", { type: "button", text });
  made.addEventListener("click", act);
  return made;
}
