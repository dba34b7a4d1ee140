/** Eyes on a phone: whose one sees, who sees through one's own, the surroundings that are scanned, marks, a miniature. */

import { Group } from "../../pages/vendor/three/three.module.min.js";

import { commonAttitude, commonFromDevice, turned } from "../../pages/axes.js";
import { element } from "../../pages/dom.js";
import { LOOK, ofKind } from "../../pages/looks.js";
import { Floor } from "../../pages/xr/floor.js";
import { Looking } from "../../pages/xr/looking.js";
import { Scanner } from "../../pages/xr/surfaces.js";
import { Cloud } from "./cloud.js";
import { FLOOR, MARK, SCAN } from "./kinds.js";
import { Marks } from "./marks.js";
import { Model, Sightings, onFloor } from "./voxels.js";

export const features = ["mesh-detection", "depth-sensing", "camera-access"];
/** s between two words of what was scanned. */
const TOLD_EVERY_S = 0.5;
/** m: who is known less well than so adds nothing to the model. */
const KNOWN_M = 0.15;
/** m: floors that differ by more are not the same one. And m/s: so fast what lies on the floor comes to it. */
const [SAME_FLOOR_M, SETTLES] = [0.6, 0.05];
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
  #model;
  #cloud = new Cloud();
  #small = new Cloud(SMALLER);
  #table = new Group();
  #marks = new Marks();
  #looking;
  #scanner = new Scanner();
  #sightings = new Sightings();
  #floor = new Floor();
  #lift = null;
  #told = 0;
  #buttons = element("div", { class: "app-row" });

  constructor(place) {
    this.#place = place;
    this.kinds = new Set([LOOK, SCAN, MARK, FLOOR]);
    this.#model = new Model(place.client);
    this.#cloud.root.visible = this.#table.visible = false;
    this.#table.scale.setScalar(SMALLER);
    this.#table.add(this.#small.root);
    place.common.add(this.#cloud.root, this.#marks.root, this.#table);
    this.#looking = new Looking(place);
    this.#button("Point at this", () => this.#point());
    this.#button("Show the model", () => (this.#cloud.root.visible = !this.#cloud.root.visible));
    this.#button("Model on a table", () => this.#putOnTable());
    place.panel.append(this.#buttons);
  }

  /** Where marks and screens are drawn, in the common frame; for tests. */
  get places() {
    return { ...this.#marks.places, ...this.#looking.places };
  }

  frame(frame, space, time) {
    const { registered, frame: own, own: pose } = this.#place;
    const device = pose()?.position[1];
    if (!registered() || !own.placing || device === undefined) return;
    const lift = own.told.sigma <= KNOWN_M ? this.#floors() : null;
    const common = ([x, y, z]) => {
      const at = commonFromDevice(own.placing, [x, y, z]);
      this.#floor.add(y, device);
      return lift === null ? null : [at[0], at[1], at[2] - lift];
    };
    this.#scanner.scan(
      frame,
      space,
      time,
      (p) => {
        const at = common(p);
        if (at) this.#sightings.add(at, time / 1000);
      },
      (...corners) => {
        const at = corners.map(common);
        if (lift !== null) this.#sightings.addTriangle(...at, time / 1000);
      },
    );
  }

  update(dt) {
    const { client, frame, registered } = this.#place;
    if (frame.told === null) this.#floor.clear();
    if (this.#cloud.root.visible) this.#cloud.update(client);
    if (this.#table.visible) this.#small.update(client);
    this.#marks.update(client);
    this.#looking.update(dt);
    this.#buttons.hidden = !registered();
    this.#settle(dt);
    this.#told += dt;
    if (this.#told < TOLD_EVERY_S) return;
    this.#told = 0;
    if (!registered()) this.#sightings.clear();
    const seen = this.#sightings.take();
    if (seen) client.say("seen", seen, "app");
    const floor = registered() && ofKind(client, FLOOR).length === 0 ? this.#ownFloor() : null;
    if (floor !== null) client.say("floor", { z: floor }, "app");
  }

  select = { start: () => {}, end: () => this.#point() };

  end() {
    const { common, panel } = this.#place;
    this.#looking.end();
    common.remove(this.#cloud.root, this.#marks.root, this.#table);
    this.#cloud.dispose();
    this.#small.dispose();
    panel.replaceChildren();
  }

  /** m, common frame, by where the device has it now: the floor that it sees; null while it has seen none. */
  #ownFloor() {
    const [{ placing }, height] = [this.#place.frame, this.#floor.height];
    return placing && height !== null ? commonFromDevice(placing, [0, height, 0])[2] : null;
  }

  /**
   * m: by how much this device sees the floor higher than the room has it. Distances say little of heights; but all
   * stand on one floor, so that what was scanned is drawn, and told, from there. Null where that is not known.
   */
  #floors() {
    const [own, [room]] = [this.#ownFloor(), ofKind(this.#place.client, FLOOR)];
    if (own === null || !room) return null;
    const lift = own - room.position[2];
    return Math.abs(lift) <= SAME_FLOOR_M ? lift : null;
  }

  #settle(dt) {
    const goal = this.#floors();
    if (goal !== null) {
      this.#lift ??= goal;
      this.#lift += Math.max(-SETTLES * dt, Math.min(SETTLES * dt, goal - this.#lift));
    }
    this.#cloud.root.position.z = this.#marks.root.position.z = this.#lift ?? 0;
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
    this.#table.position.set(...middle, z + (this.#lift ?? 0) - BELOW_M - SMALLER * this.#model.floor);
    this.#table.visible = true;
  }

  /** {position, way} of the device, as high above the room's floor as it is above its own; null where it is not known. */
  #eye() {
    const { own, frame, registered } = this.#place;
    const pose = own();
    if (!pose || !registered() || !frame.placing) return null;
    const way = turned(commonAttitude(frame.placing, pose.quat_xyzw), [0, 0, -1]);
    const [x, y, z] = commonFromDevice(frame.placing, pose.position);
    return { position: [x, y, z - (this.#lift ?? 0)], way };
  }

  #button(text, act) {
    const made = element("button", { type: "button", text });
    made.addEventListener("click", act);
    this.#buttons.append(made);
  }
}
