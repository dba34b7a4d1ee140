/**
 * A client of a room, for browsers and Node. docs/protocol.md says what each message is.
 *
 *     const room = new RoomClient({ server: "https://192.168.0.7:47180", room: "ABCDEFGH", users: [{ name: "ann", up: "y" }] });
 *     room.addEventListener("frames", ({ detail }) => console.log(detail.users.ann.state));
 *     room.addEventListener("poses", ({ detail }) => detail.poses.forEach((pose) => console.log(pose.name, pose.position)));
 *     await room.connect();
 *     room.sendPose([x, y, z], [qx, qy, qz, qw], t);    // in the device's own axes, by its own clock (clock.js), s
 *
 * Events are named by the `type` of what the room says (welcome, members, frames, objects, events, status, said,
 * signalled, module_key, refused, answer, bye), with the message as `detail`; besides them `poses` (everybody's, 30
 * times a second), and `state`, whose detail is {state: "joining" | "open" | "waiting" | "closed", reason, what}.
 * A connection that breaks is made anew, as the same devices; what cannot be mended ends in `closed`.
 */

import { ClockOffset, PlayedClock, deviceNow } from "./clock.js";
import { decodePoses, encodePose } from "./poses.js";
import { WebTransportSocket } from "./webtransport.js";

export const PROTOCOL = 1;

/** Bytes that may wait in the socket before a pose waits outside, where the next one takes its place. */
export const MOST_BUFFERED = 4096;

const PING_S = 2;
const FIRST_PINGS = 4;
const FIRST_PING_S = 0.1;
/** s without a pong after which a connection is taken for broken. */
const SILENT_S = 7;
/** s within which the room has to welcome; a network that swallows datagrams later on is noticed by it too. */
const WELCOME_S = 6;
const RETRY_S = [0.25, 0.5, 1, 2, 4, 5];
/** `bye` after which a client does not come again by itself. */
const FINAL = new Set(["left", "elsewhere", "protocol"]);
const MOST_QUEUED = 200;
/** What a room says, by `type`; whatever else a later version of it says is left alone. */
const TYPES = new Set(
  "welcome pong members frames objects events status module_key said signalled refused answer bye".split(" "),
);

/** Why somebody was not let in: `reason` is one word, the message one sentence with a way on. */
export class JoinError extends Error {
  constructor(reason, what) {
    super(what);
    this.name = "JoinError";
    this.reason = reason;
  }
}

/** An address of the server: "live" of "https://room.example/a" is "https://room.example/a/live". */
function addressAt(server, path) {
  const base = new URL(server);
  if (!base.pathname.endsWith("/")) base.pathname += "/";
  return new URL(path, base);
}

/** Buys a token with a room's code: {token, expires, resume, room, users, ...}. Throws JoinError. */
export async function join(server, request, fetch = globalThis.fetch) {
  let response;
  try {
    response = await fetch(addressAt(server, "api/join"), {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(request),
    });
  } catch {
    throw new JoinError("network", "The room's computer does not answer. Is this device in the same network?");
  }
  const answer = await response.json().catch(() => ({}));
  if (response.ok) return answer;
  throw new JoinError(answer.reason ?? "server", answer.what ?? `The server answered ${response.status}.`);
}

/** One connection to a room, which hosts no device (it only looks), one, or several. */
export class RoomClient extends EventTarget {
  #options;
  #socket = null;
  #resume;
  #attempt = 0;
  #timers = new Set();
  #pingTimer = null;
  #heardAt = 0;
  #pings = 0;
  #clock = new ClockOffset();
  #played = new PlayedClock();
  #recorded = false;
  #sequence = 0;
  #held = new Map();
  #holding = false;
  #queue = [];
  #newFrames;
  #posesHeard = null;
  #first = null;
  #mayTransport;

  /**
   * `server`: its address; `room`: its code; `users`: settings of the devices that this client speaks for
   * ({name, up, static, height_sigma, position, antennas, ...}); `resume`: of an earlier connection (`client.resume`), to be the same
   * devices after a reload: their SLAM began another frame then, unless `sameFrames`. Poses go by WebTransport where
   * browser and server have it, by the WebSocket otherwise. `webTransport: false`: always by the WebSocket.
   */
  constructor({ server, room, users = [], resume = null, sameFrames = false, now = deviceNow, ...other } = {}) {
    super();
    const { WebSocket, WebTransport, fetch } = { ...offered(), ...other };
    this.#options = { server, room, users, WebSocket, WebTransport, fetch };
    this.#mayTransport = (other.webTransport ?? true) && WebTransport !== undefined;
    this.#resume = resume;
    this.#newFrames = resume !== null && !sameFrames;
    this.now = now;
    this.state = "closed";
    /** What carries it now: "webtransport" or "websocket"; null where nothing does. */
    this.transport = null;
    /** Names of the devices that this client speaks for. */
    this.you = [];
    /** The newest `frames` message; null before the first. */
    this.frames = null;
    /** The newest `status` message. */
    this.status = null;
    /** Members by their index. */
    this.members = new Map();
    /** Objects by id, as they stand. */
    this.objects = new Map();
    /** How many messages of the room this client does not know and has left alone, by type. */
    this.notUnderstood = new Map();
  }

  /** To be given to a new client, after a reload, in order to be the same devices. Not for anybody else's eyes. */
  get resume() {
    return this.#resume;
  }

  /** Time by the room's clock, s; null before the first pong. */
  get roomTime() {
    if (this.#recorded) return this.#played.at(this.now());
    const best = this.#clock.best;
    return best === null ? null : this.now() + best.offset;
  }

  /** s of the quickest recent ping and pong; null before the first. */
  get roundTrip() {
    return this.#clock.best?.roundTrip ?? null;
  }

  /** Join; resolves with `welcome`. Throws JoinError where the room does not let this client in. */
  async connect() {
    if (this.state !== "closed") throw new Error("it is connected already");
    const welcomed = new Promise((resolve, reject) => (this.#first = { resolve, reject }));
    this.#open();
    return welcomed;
  }

  /** Come again at once where the connection is broken: for a page that was asleep. */
  wake() {
    if (this.state === "waiting") this.#retry(0);
    else if (this.state === "open") this.#ping();
  }

  /** Leave the room for good. */
  leave() {
    if (this.state === "open") this.#say({ type: "leave" });
    this.close();
  }

  /** Close the connection; the devices stay in the room and may come again. */
  close() {
    this.#end("closed", "This device has left the room.");
  }

  /**
   * A pose in the axes of the device's own SLAM: position [x, y, z] m, attitude x y z w, stamp s by `now`'s clock.
   * Where the network is slower than poses come, the latest is sent and those before it are left out.
   */
  sendPose(position, quat_xyzw, t = this.now(), user = 0) {
    if (this.state !== "open") return;
    const member = this.member(this.you[user]);
    if (!member) return;
    const sequence = this.#sequence++;
    this.#held.set(user, encodePose({ user, frame: member.frame, sequence, t, position, quat_xyzw }));
    this.#flush();
  }

  /** Distances that this client's devices measured: [{t, a, b, distance, sigma, ...}], t by `now`'s clock. */
  sendRanges(ranges) {
    this.#send({ type: "ranges", ranges });
  }

  /** A device's SLAM began anew, in another frame. */
  reset(user = 0) {
    const member = this.member(this.you[user]);
    if (!member) return;
    member.frame = (member.frame + 1) % 256;
    this.#held.delete(user);
    this.#send({ type: "reset", user: member.name, frame: member.frame });
  }

  /** A device's SLAM lost track; it may find itself again. */
  lost(user = 0) {
    this.#send({ type: "lost", user: this.you[user] });
  }

  /** A device's module will send ranges by UDP; answered by a `module_key` event. */
  module(address, user = 0) {
    this.#send({ type: "module", user: this.you[user], address });
  }

  /**
   * Puts an object into the room. With `user` (a name) the place is in that device's own frame and axes: the object
   * waits until the device is registered, and then stands for good. Returns its id.
   */
  create({ id = newId(), kind, position, quat_xyzw = [0, 0, 0, 1], user = null, data = null, hold = false }) {
    this.#send({ type: "create", id, kind, position, quat_xyzw, user, data, hold });
    return id;
  }

  /** Asks for an object; who holds it may move it. */
  grab(id) {
    this.#send({ type: "grab", id });
  }

  /** Moves an object that this client holds: {position, quat_xyzw, velocity, data}, common frame. */
  move(id, change) {
    this.#send({ type: "move", id, ...change });
  }

  release(id) {
    this.#send({ type: "release", id });
  }

  remove(id) {
    this.#send({ type: "remove", id });
  }

  /** A word of an application to one device's client, or to all others. */
  say(topic, data = null, to = null) {
    this.#send({ type: "say", topic, data, to });
  }

  /** WebRTC signalling to a device's client, or to "room". */
  signal(to, data) {
    this.#send({ type: "signal", to, data });
  }

  /** The member of that name. */
  member(name) {
    for (const member of this.members.values()) if (member.name === name) return member;
    return undefined;
  }

  // Connecting

  async #open() {
    const { server, room, users, fetch } = this.#options;
    this.#become("joining");
    try {
      const joined = await join(server, { room, users, resume: this.#resume }, fetch);
      if (this.state !== "joining") return;
      this.#resume = joined.resume;
      this.#connect(joined);
    } catch (error) {
      if (!(error instanceof JoinError)) throw error;
      if (this.state !== "joining") return;
      if (this.#first || !["network", "server", "tries"].includes(error.reason)) {
        this.#end(error.reason, error.message);
      } else {
        this.#broken();
      }
    }
  }

  #connect(joined) {
    const { server, WebSocket, WebTransport } = this.#options;
    const address = addressAt(server, "live");
    const { webtransport_port: port, webtransport_sha256: sha256 } = joined;
    let socket;
    if (this.#mayTransport && port && sha256) {
      address.port = port;
      this.transport = "webtransport";
      socket = new WebTransportSocket(address.href, sha256, WebTransport);
    } else {
      address.protocol = address.protocol === "http:" ? "ws:" : "wss:";
      this.transport = "websocket";
      socket = new WebSocket(address.href);
      socket.binaryType = "arraybuffer";
    }
    let open = false;
    this.#socket = socket;
    this.#heardAt = this.now();
    socket.onopen = () => {
      open = true;
      socket.send(JSON.stringify({ type: "hello", token: joined.token, protocol: PROTOCOL }));
    };
    socket.onmessage = ({ data }) => this.#socket === socket && this.#hear(data);
    socket.onclose = () => {
      if (this.#socket !== socket) return;
      if (open || this.transport === "websocket") {
        this.#broken();
        return;
      }
      // A network that lets no UDP through: the token is still good.
      this.#mayTransport = false;
      this.#connect(joined);
    };
    this.#later(WELCOME_S, () => {
      if (this.#socket !== socket || this.state !== "joining") return;
      if (this.transport === "webtransport") this.#mayTransport = false;
      this.#broken();
    });
  }

  #broken() {
    this.#drop();
    if (this.#first && this.#attempt >= RETRY_S.length) {
      this.#end("network", "The connection to the room breaks off at once. Is something between that forbids WebSockets?");
      return;
    }
    this.#become("waiting", "network", "The connection to the room is broken. It is being made anew.");
    const wait = RETRY_S[Math.min(this.#attempt++, RETRY_S.length - 1)];
    this.#retry(wait * (0.75 + 0.5 * Math.random()));
  }

  #retry(seconds) {
    this.#clearTimers();
    this.#later(seconds, () => this.state === "waiting" && this.#open());
  }

  #end(reason, what) {
    this.#drop();
    this.#clearTimers();
    this.#queue = [];
    this.#become("closed", reason, what);
    this.#first?.reject(new JoinError(reason, what));
    this.#first = null;
  }

  #drop() {
    const socket = this.#socket;
    this.#socket = null;
    this.transport = null;
    this.#held.clear();
    this.#holding = false;
    clearTimeout(this.#pingTimer);
    socket?.close();
  }

  #become(state, reason = "", what = "") {
    if (this.state === state) return;
    this.state = state;
    this.#tell("state", { state, reason, what });
  }

  // Hearing

  #hear(data) {
    this.#heardAt = this.now();
    const isText = typeof data === "string";
    let heard;
    try {
      heard = isText ? JSON.parse(data) : decodePoses(data);
    } catch {
      this.#leaveAlone(isText ? "malformed" : "binary");
      return;
    }
    if (isText) this.#hearWord(heard);
    else this.#hearPoses(heard);
  }

  #hearPoses({ sequence, t, poses }) {
    // Datagrams overtake one another; many devices' poses come in several, of one number.
    if (this.#posesHeard !== null && ((sequence - this.#posesHeard) | 0) < 0) return;
    this.#posesHeard = sequence;
    this.#clock.heard(t, this.#heardAt);
    this.#played.heard(t, this.#heardAt);
    for (const pose of poses) pose.name = this.members.get(pose.member)?.name;
    this.#tell("poses", { sequence, t, poses: poses.filter((pose) => pose.name !== undefined) });
  }

  #hearWord(message) {
    if (!TYPES.has(message?.type)) {
      this.#leaveAlone(typeof message?.type === "string" ? message.type : "malformed");
      return;
    }
    switch (message.type) {
      case "welcome":
        this.#welcome(message);
        break;
      case "pong":
        this.#clock.hear(message, this.now());
        this.#recorded = message.recorded ?? false;
        break;
      case "members":
        this.#takeMembers(message.members);
        break;
      case "frames":
        this.frames = message;
        break;
      case "objects":
        this.#takeObjects(message);
        break;
      case "status":
        this.status = message;
        break;
      case "bye":
        this.#tell("bye", message);
        if (FINAL.has(message.reason)) this.#end(message.reason, message.what);
        return;
    }
    this.#tell(message.type, message);
  }

  /** Of a later version of the room, perhaps: counted, and nothing else. */
  #leaveAlone(kind) {
    this.notUnderstood.set(kind, (this.notUnderstood.get(kind) ?? 0) + 1);
  }

  #welcome(message) {
    this.you = message.you;
    this.frames = message.frames;
    this.#takeMembers(message.members ?? []);
    this.objects.clear();
    this.#takeObjects(message.objects);
    this.#attempt = 0;
    this.#posesHeard = null;
    this.#pings = 0;
    this.#clock.clear();
    this.#become("open");
    if (this.#newFrames) this.you.forEach((_, user) => this.reset(user));
    this.#newFrames = false;
    this.#ping();
    for (const word of this.#queue.splice(0)) this.#say(word);
    this.#first?.resolve(message);
    this.#first = null;
  }

  #takeMembers(members) {
    const defaults = { here: true, static: false, up: "z", frame: 0 };
    this.members = new Map(members.map((member) => [member.index, { ...defaults, ...member }]));
  }

  #takeObjects({ changed = [], removed = [] }) {
    for (const object of changed) this.objects.set(object.id, { holder: null, velocity: null, data: null, ...object });
    for (const id of removed) this.objects.delete(id);
  }

  #tell(type, detail) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }

  // Saying

  #ping() {
    clearTimeout(this.#pingTimer);
    if (this.now() - this.#heardAt > SILENT_S) {
      this.#broken();
      return;
    }
    const best = this.#clock.best;
    const known = best === null ? {} : { offset: best.offset, round_trip: best.roundTrip };
    this.#say({ type: "ping", t: this.now(), ...known });
    const wait = ++this.#pings < FIRST_PINGS ? FIRST_PING_S : PING_S;
    this.#pingTimer = setTimeout(() => this.state === "open" && this.#ping(), 1000 * wait);
  }

  /** What must not be lost waits while the connection is made anew. */
  #send(message) {
    if (this.state === "open") this.#say(message);
    else if (this.state !== "closed" && message.type !== "ranges" && this.#queue.length < MOST_QUEUED) {
      this.#queue.push(message);
    }
  }

  #say(message) {
    this.#socket?.send(JSON.stringify(message));
  }

  #flush() {
    if (this.#socket.bufferedAmount <= MOST_BUFFERED) {
      for (const bytes of this.#held.values()) this.#socket.send(bytes);
      this.#held.clear();
    } else if (!this.#holding) {
      this.#holding = true;
      this.#later(0.02, () => {
        this.#holding = false;
        if (this.state === "open" && this.#held.size) this.#flush();
      });
    }
  }

  #later(seconds, then) {
    const timer = setTimeout(() => {
      this.#timers.delete(timer);
      then();
    }, 1000 * seconds);
    this.#timers.add(timer);
  }

  #clearTimers() {
    for (const timer of this.#timers) clearTimeout(timer);
    this.#timers.clear();
  }
}

/** What a browser or Node offers. */
function offered() {
  const { WebSocket, WebTransport, fetch } = globalThis;
  return { WebSocket, WebTransport, fetch };
}

/** An id that nobody else chooses. */
export function newId() {
  const bytes = crypto.getRandomValues(new Uint8Array(9));
  return btoa(String.fromCharCode(...bytes)).replaceAll("+", "-").replaceAll("/", "_");
}
