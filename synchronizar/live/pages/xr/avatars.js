/** The others, in place: a head, what it looks at, its name, and how well its place is known. In the common frame, z up. */

import {
  BufferAttribute,
  BufferGeometry,
  Group,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  MeshBasicMaterial,
  MeshStandardMaterial,
  SphereGeometry,
} from "../vendor/three/three.module.min.js";

import { Z_UP_FROM_Y_UP, placingOf } from "../axes.js";
import { covarianceAt, ellipse } from "../smoothing.js";
import { colourOf } from "../view/colours.js";
import { dispose, label } from "./label.js";
import { Motion } from "./motion.js";

const HEAD_M = 0.11;
const FRUSTUM_M = [0.16, 0.22, 0.35];
/** Half-axes of the ellipsoid in sigmas: 95 % in a plane lie within. */
const SIGMAS = 2.45;
const WIDEST_M = 3;

const HEAD = new SphereGeometry(HEAD_M, 24, 16);
const BALL = new SphereGeometry(1, 24, 16);
const FRUSTUM = frustum(FRUSTUM_M);

export class Avatars {
  #client;
  #avatars = new Map();

  /** `group`: where the common frame is drawn. */
  constructor(client, group) {
    this.#client = client;
    this.group = group;
    client.addEventListener("poses", ({ detail }) => this.#poses(detail));
    client.addEventListener("frames", ({ detail }) => this.#frames(detail));
    client.addEventListener("members", () => this.#members());
  }

  /** By name, where each is drawn now, and as at when: {t, position, state}. For tests and for applications. */
  get places() {
    const shown = [...this.#avatars.values()].filter(({ root }) => root.visible);
    return Object.fromEntries(shown.map(({ name, now }) => [name, { t: now.t, position: now.position, state: now.state }]));
  }

  /** Where somebody is drawn now: {position, quat_xyzw} in the common frame; null of who is not. */
  placeOf(name) {
    const avatar = this.#avatars.get(name);
    return avatar?.root.visible ? avatar.now : null;
  }

  /** Everybody as at `roomTime`, in `opacity` of all. */
  update(roomTime, opacity) {
    for (const avatar of this.#avatars.values()) avatar.update(roomTime, opacity);
  }

  #poses({ t, poses }) {
    for (const pose of poses) {
      if (this.#client.you.includes(pose.name)) continue;
      let avatar = this.#avatars.get(pose.name);
      if (!avatar) {
        avatar = new Avatar(this.#client.members.get(pose.member), this.group);
        this.#avatars.set(pose.name, avatar);
        avatar.told(this.#client.frames?.users[pose.name]);
      }
      avatar.motion.add(t - pose.age, pose.position, pose.quat_xyzw, pose.state);
    }
  }

  #frames({ users }) {
    for (const avatar of this.#avatars.values()) avatar.told(users[avatar.name]);
  }

  #members() {
    for (const [name, avatar] of this.#avatars) {
      if (this.#client.member(name)) continue;
      avatar.remove();
      this.#avatars.delete(name);
    }
  }
}

class Avatar {
  #frame = null;

  constructor({ name, index, up, static: still }, group) {
    this.name = name;
    this.static = still;
    this.motion = new Motion();
    this.now = null;
    const colour = colourOf(index, true);
    this.head = new Mesh(HEAD, new MeshStandardMaterial({ color: colour, roughness: 0.5, transparent: true }));
    this.sight = new LineSegments(FRUSTUM, new LineBasicMaterial({ color: colour, transparent: true }));
    // The frustum looks along -z; a body that is z up looks along its own x.
    if (up === "z") this.sight.quaternion.set(...Z_UP_FROM_Y_UP);
    this.sight.visible = !still;
    this.body = new Group();
    this.body.add(this.head, this.sight);
    this.doubt = new Mesh(BALL, new MeshBasicMaterial({ color: colour, transparent: true, depthWrite: false }));
    this.name_ = label(name, colour);
    this.name_.position.set(0, 0, 2.6 * HEAD_M);
    this.root = new Group();
    this.root.add(this.body, this.doubt, this.name_);
    this.root.visible = false;
    this.root.userData.moves = !still;
    this.group = group;
    group.add(this.root);
  }

  /** Its frame, for the ellipsoid. */
  told(frame) {
    this.#frame = frame ?? null;
  }

  update(roomTime, opacity) {
    const now = this.motion.at(roomTime);
    this.root.visible = now !== null && opacity > 0;
    if (!this.root.visible) return;
    this.now = now;
    const sure = now.state === "registered";
    const share = opacity * now.opacity * (sure ? 1 : 0.4);
    this.root.position.set(...now.position);
    this.body.quaternion.set(...now.quat_xyzw);
    this.head.material.opacity = this.sight.material.opacity = this.name_.material.opacity = share;
    this.doubt.material.opacity = 0.16 * opacity * now.opacity;
    this.#ellipsoid(now.position);
  }

  #ellipsoid([x, y]) {
    const placing = placingOf(this.#frame);
    const covariance = this.#frame?.covariance;
    this.doubt.visible = Boolean(placing && covariance) && covariance.slice(0, 3).every((row, i) => row[i] !== null);
    if (!this.doubt.visible) return;
    const level = { x: 0, y: 0, z: 0, yaw: 0, scale: 1 };
    const turns = covariance[3][3] !== null;
    const there = turns ? covarianceAt(covariance, level, [x - placing.x, y - placing.y, 0]) : covariance;
    const { major, minor, direction } = ellipse(there);
    const axes = [major, minor, Math.sqrt(Math.max(0, covariance[2][2]))];
    this.doubt.scale.set(...axes.map((sigma) => Math.min(WIDEST_M, Math.max(0.02, SIGMAS * sigma))));
    this.doubt.rotation.set(0, 0, direction);
  }

  remove() {
    this.group.remove(this.root);
    for (const { material } of [this.head, this.sight, this.doubt]) material.dispose();
    dispose(this.name_);
  }
}

/** Edges of what a camera sees that looks along -z: half width, half height, depth (m). */
function frustum([w, h, d]) {
  const corners = [
    [-w, -h, -d],
    [w, -h, -d],
    [w, h, -d],
    [-w, h, -d],
  ];
  const eye = [0, 0, 0];
  const edges = corners.flatMap((corner, i) => [eye, corner, corner, corners[(i + 1) % 4]]);
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(edges.flat()), 3));
  return geometry;
}
