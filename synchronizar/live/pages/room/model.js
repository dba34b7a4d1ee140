/** What a room's page shows, gathered from what the room says. No elements, no drawing. */

import { heading, placingOf } from "../axes.js";
import { covarianceAt, ellipse } from "../smoothing.js";

/** s of everybody's track that are kept, and m between two points of it. */
export const TRAIL_S = 20;
const TRAIL_STEP_M = 0.05;
/** m, and m/s: a longer step in between is a correction or a jump, and no walk. */
const TRAIL_GAP_M = 0.6;
const FASTEST = 3;
const MOST_EVENTS = 200;
const GONE_S = 0.5;
/** s after which a pose is old, and whoever it is of is drawn faded. */
export const OLD_S = 1.5;

export class RoomModel {
  #client;

  constructor(client) {
    this.#client = client;
    /** By name: {name, index, here, static, up, frame, told, pose, trail, health}. */
    this.users = new Map();
    /** Newest range of each pair. */
    this.pairs = [];
    /** Newest last: {t, text}. */
    this.events = [];
    this.refused = {};
    this.behind = null;
    this.reference = null;
    this.posesAt = null;
    client.addEventListener("welcome", ({ detail }) => this.#welcome(detail));
    client.addEventListener("members", () => this.#members());
    client.addEventListener("frames", ({ detail }) => this.#frames(detail));
    client.addEventListener("poses", ({ detail }) => this.#poses(detail));
    client.addEventListener("status", ({ detail }) => this.#status(detail));
    client.addEventListener("events", ({ detail }) => this.#events(detail));
  }

  /** Those who are in the room, by their index. */
  get present() {
    return [...this.users.values()].sort((a, b) => a.index - b.index);
  }

  #welcome(message) {
    this.users.clear();
    this.#members();
    this.#frames(message.frames);
  }

  #members() {
    const names = new Set();
    for (const member of this.#client.members.values()) {
      names.add(member.name);
      const user = this.users.get(member.name) ?? { told: null, pose: null, trail: [], health: null };
      if (user.frame !== undefined && user.frame !== member.frame) user.trail.push(null);
      this.users.set(member.name, Object.assign(user, member));
    }
    for (const name of [...this.users.keys()]) if (!names.has(name)) this.users.delete(name);
  }

  #frames({ users, reference }) {
    this.reference = reference;
    for (const user of this.users.values()) user.told = users[user.name] ?? null;
  }

  #poses({ t, poses }) {
    this.posesAt = t;
    for (const pose of poses) {
      const user = this.users.get(pose.name);
      if (!user) continue;
      const [x, y, z] = pose.position;
      const turned = user.static ? null : heading(pose.quat_xyzw, user.up);
      const { state, age } = pose;
      user.pose = { x, y, z, quat_xyzw: pose.quat_xyzw, heading: turned, state, age, ellipse: this.#ellipse(user, pose), heard: t };
      extend(user.trail, t - pose.age, x, y);
    }
    // Many devices' poses come in several messages: who is in none for a while has no place.
    for (const user of this.users.values()) if (user.pose && t - user.pose.heard > GONE_S) user.pose = null;
  }

  /** Of a user's place, 1 sigma, from the covariance of its frame's origin. */
  #ellipse(user, { position: [x, y] }) {
    const placing = placingOf(user.told);
    const covariance = user.told?.covariance;
    if (!placing || !covariance || covariance.slice(0, 2).some((row) => row[0] === null || row[1] === null)) return null;
    if (user.static || covariance[3][3] === null) return ellipse(covariance);
    // Where the device is in its own frame, turned into the common one: all that the covariance there needs.
    const at = { x: 0, y: 0, z: 0, yaw: 0, scale: 1 };
    return ellipse(covarianceAt(covariance, at, [x - placing.x, y - placing.y, 0]));
  }

  #status({ users, pairs, refused, behind }) {
    for (const user of this.users.values()) user.health = users[user.name] ?? null;
    this.pairs = pairs;
    this.refused = refused;
    this.behind = behind;
  }

  #events({ t, events }) {
    this.events.push(...events.map((text) => ({ t, text })));
    this.events.splice(0, this.events.length - MOST_EVENTS);
  }
}

/** One more point of a track, where it is far enough from the last; null stands where a track breaks. */
export function extend(trail, t, x, y) {
  const last = trail.at(-1);
  const step = last ? Math.hypot(x - last.x, y - last.y) : Infinity;
  if (last && step > Math.max(TRAIL_GAP_M, FASTEST * (t - last.t))) trail.push(null);
  if (step >= TRAIL_STEP_M) trail.push({ t, x, y });
  while (trail.length && (trail[0] === null || trail[0].t < t - TRAIL_S)) trail.shift();
}
