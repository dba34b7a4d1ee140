/** The room's objects as simple shapes in the common frame, and those of one's own that still wait for their place. */

import {
  BoxGeometry,
  ConeGeometry,
  Group,
  Mesh,
  MeshStandardMaterial,
  SphereGeometry,
} from "../vendor/three/three.module.min.js";

import { UPRIGHT_IN_Y_UP, commonFromDevice, deviceFromCommon } from "../axes.js";
import { colourOf } from "../view/colours.js";
import { Anchored } from "./anchors.js";
import { dispose, label } from "./label.js";

const SHAPES = {
  marker: new ConeGeometry(0.06, 0.18, 24).rotateX(-Math.PI / 2).translate(0, 0, 0.09),
  ball: new SphereGeometry(0.1, 24, 16),
};
const OTHER = new BoxGeometry(0.15, 0.15, 0.15);
const FOLLOWING_S = 0.08;
/** m: what has come so near to its place stands there. */
const STANDS_M = 0.005;

export class Objects {
  #client;
  #common;
  #own;
  #holding;
  #anchors;
  #shown = new Map();
  #left = new Set();
  #waiting = new Map();

  /** `common`: where the common frame is drawn; `own`: where the device's own is. */
  constructor(client, common, own, holding, anchors) {
    this.#holding = holding;
    this.#anchors = anchors;
    this.#client = client;
    this.#common = common;
    this.#own = own;
    client.addEventListener("objects", () => this.#take());
    client.addEventListener("welcome", () => this.#take());
    if (client.state === "open") this.#take();
  }

  /** Leave objects of these kinds to somebody else, who draws them. */
  leave(kinds) {
    this.#left = kinds;
    this.#take();
  }

  /** Ids of what is shown in place. */
  get ids() {
    return [...this.#shown.keys()];
  }

  /** Where they are drawn, in the common frame, by their ids; for tests. */
  get places() {
    return Object.fromEntries([...this.#shown].map(([id, { root }]) => [id, root.position.toArray()]));
  }

  /** How many of one's own wait for their place. */
  get waiting() {
    return this.#waiting.size;
  }

  /** An object of one's own that the room has not placed yet, at `position` of the device's own frame. */
  wait(id, kind, position, colour) {
    const ghost = shape(kind, colour);
    ghost.material.opacity = 0.4;
    ghost.position.set(...position);
    ghost.quaternion.set(...UPRIGHT_IN_Y_UP);
    this.#own.add(ghost);
    this.#waiting.set(id, ghost);
  }

  /**
   * Goes on, `dt` s after the last time: what is held follows its holder, what flies flies, what stands hangs on its
   * anchor. `placing`: where the common frame is shown, or null; the device is `here` in its own frame.
   */
  update(dt, roomTime, opacity, placing, here) {
    const standing = [];
    for (const shown of this.#shown.values()) {
      const object = this.#client.objects.get(shown.id);
      if (!object) continue;
      shown.mesh.material.opacity = shown.tag.material.opacity = opacity;
      if (this.#move(shown, object, dt, roomTime) && placing) standing.push([shown, ownOf(placing, object.position)]);
    }
    this.#anchors.update(standing.map(([{ id }, place]) => [id, place]), here);
    for (const [{ id, root, anchored }, place] of standing) {
      root.position.set(...commonFromDevice(placing, anchored.step(dt, place, this.#anchors.at(id))));
    }
  }

  /** Whether it stands: else it is where it is now. */
  #move(shown, object, dt, roomTime) {
    const { id, root, mesh } = shown;
    const held = this.#holding.poseOf(id);
    if (held) {
      root.position.set(...held.position);
      mesh.quaternion.set(...held.quat_xyzw);
    } else {
      const ahead = object.velocity && roomTime !== null ? Math.min(1, Math.max(0, roomTime - object.t)) : 0;
      const goal = object.position.map((v, i) => v + ahead * (object.velocity?.[i] ?? 0));
      const share = 1 - Math.exp(-dt / FOLLOWING_S);
      const here = root.position.toArray();
      root.position.set(...here.map((v, i) => v + share * (goal[i] - v)));
      mesh.quaternion.set(...object.quat_xyzw);
    }
    const moves = held !== null || object.holder !== null || object.velocity !== null;
    const far = Math.hypot(...root.position.toArray().map((v, i) => v - object.position[i])) > STANDS_M;
    if (moves || (far && shown.anchored === null)) {
      this.#anchors.drop(id);
      shown.anchored = null;
      return false;
    }
    shown.anchored ??= new Anchored();
    return true;
  }

  #take() {
    const drawn = [...this.#client.objects.values()].filter(({ kind }) => !this.#left.has(kind));
    const ids = new Set(drawn.map(({ id }) => id));
    for (const object of drawn) if (!this.#shown.has(object.id)) this.#add(object);
    for (const [id, { root, mesh, tag }] of this.#shown) {
      if (ids.has(id)) continue;
      this.#common.remove(root);
      mesh.material.dispose();
      dispose(tag);
      this.#shown.delete(id);
    }
  }

  #add({ id, kind, position, by }) {
    const colour = colourOf(this.#client.member(by)?.index ?? 6, true);
    const mesh = shape(kind, colour);
    const tag = label(by, colour);
    tag.position.set(0, 0, 0.27);
    const root = new Group();
    root.position.set(...position);
    root.add(mesh, tag);
    this.#common.add(root);
    this.#shown.set(id, { id, root, mesh, tag, anchored: null });
    const ghost = this.#waiting.get(id);
    if (ghost) {
      this.#own.remove(ghost);
      ghost.material.dispose();
      this.#waiting.delete(id);
    }
  }
}

/** A place of the common frame, in the device's own (y up). */
function ownOf(placing, [x, y, z]) {
  const m = deviceFromCommon(placing, "y");
  return [0, 1, 2].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]);
}

function shape(kind, colour) {
  return new Mesh(SHAPES[kind] ?? OTHER, new MeshStandardMaterial({ color: colour, transparent: true, roughness: 0.6 }));
}
