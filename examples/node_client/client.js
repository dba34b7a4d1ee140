// A client of a room in plain Node, written from docs/protocol.md alone. It needs nothing but `ws`.

import { EventEmitter } from "node:events";
import http from "node:http";
import https from "node:https";
import tls from "node:tls";

import WebSocket from "ws";

const [POSE, POSES] = [1, 2];
const [POSE_BYTES, HEAD_BYTES, RECORD_BYTES] = [56, 16, 48];
// What a room says; whatever else a later version of it says is left alone.
const TYPES = new Set(
  "pong members frames objects events status module_key said signalled refused answer bye".split(" "),
);
const STATES = ["registered", "ambiguous", "unobservable", "disconnected"];
const [FIRST_PINGS, FIRST_PING_MS, PING_MS, QUICKEST_OF] = [4, 100, 2000, 8];

// One connection to a room. It emits each message of the room by its type, "poses" for everybody's, and "close".
export class RoomClient extends EventEmitter {
  #socket;
  #clock;
  #frame = new Map();
  #sequence = 0;
  #trips = [];
  #pinging;

  // `users`: settings of the devices that this connection speaks for. `clock`: what stamps their poses, in s.
  static async join(address, users, { clock = monotonic, resume = null } = {}) {
    const url = new URL(address);
    const base = `${url.origin}${url.pathname.replace(/\/$/, "")}`;
    const trusted = url.protocol === "https:" ? await trust(url) : {};
    const joined = await post(`${base}/api/join`, { room: url.hash.slice(1), users, resume }, trusted);
    const socket = new WebSocket(`${base.replace(/^http/, "ws")}/live`, trusted);
    await heard(socket, "open");
    socket.send(JSON.stringify({ type: "hello", token: joined.token, protocol: 1 }));
    const [data] = await heard(socket, "message");
    const welcome = JSON.parse(data);
    if (welcome.type !== "welcome") throw new Error(welcome.what);
    return new RoomClient(socket, welcome, joined.resume, clock);
  }

  constructor(socket, welcome, resume, clock) {
    super();
    this.#socket = socket;
    this.#clock = clock;
    this.you = welcome.you;
    this.members = welcome.members;
    this.frames = welcome.frames;
    this.poses = new Map();
    this.resume = resume;
    this.notUnderstood = 0;
    for (const member of welcome.members) this.#frame.set(member.name, member.frame ?? 0);
    socket.on("message", (data, binary) => (binary ? this.#takePoses(data) : this.#take(JSON.parse(data))));
    socket.on("error", (error) => this.emit("close", error));
    socket.on("close", () => {
      clearTimeout(this.#pinging);
      this.emit("close");
    });
    if (this.you.length) this.#ping(0);
  }

  // Where a device is in the axes of its own SLAM: s by the clock, m, x y z w.
  sendPose(user, t, position, quat) {
    const bytes = Buffer.alloc(POSE_BYTES);
    bytes.writeUInt8(POSE, 0);
    bytes.writeUInt8(this.#frame.get(user), 1);
    bytes.writeUInt16LE(this.you.indexOf(user), 2);
    this.#sequence = (this.#sequence + 1) >>> 0;
    bytes.writeUInt32LE(this.#sequence, 4);
    bytes.writeDoubleLE(t, 8);
    position.forEach((value, i) => bytes.writeDoubleLE(value, 16 + 8 * i));
    quat.forEach((value, i) => bytes.writeFloatLE(value, 40 + 4 * i));
    this.#socket.send(bytes);
  }

  // A distance (m) that one of this connection's devices measured at `t`.
  sendRange(t, a, b, distance, columns = {}) {
    this.say({ type: "ranges", ranges: [{ t, a, b, distance, ...columns }] });
  }

  // SLAM of a device has begun anew: its poses are in another frame from now on.
  newFrame(user) {
    this.#frame.set(user, (this.#frame.get(user) + 1) % 256);
    this.say({ type: "reset", user, frame: this.#frame.get(user) });
  }

  // Any message that the protocol knows.
  say(message) {
    this.#socket.send(JSON.stringify(message));
  }

  close() {
    this.#socket.close();
  }

  #take(message) {
    if (!TYPES.has(message.type)) {
      this.notUnderstood += 1;
      return;
    }
    if (message.type === "members") this.members = message.members;
    if (message.type === "frames") this.frames = message;
    if (message.type === "pong") this.#pong(message);
    this.emit(message.type, message);
  }

  #takePoses(bytes) {
    if (bytes.readUInt8(0) !== POSES) return;
    const nameOf = new Map(this.members.map(({ name, index }) => [index, name]));
    this.poses = new Map();
    for (let i = 0; i < bytes.readUInt16LE(2); i += 1) {
      const at = HEAD_BYTES + i * RECORD_BYTES;
      this.poses.set(nameOf.get(bytes.readUInt16LE(at)), {
        state: STATES[bytes.readUInt8(at + 2)],
        frame: bytes.readUInt8(at + 3),
        age: bytes.readFloatLE(at + 4),
        position: [0, 1, 2].map((k) => bytes.readDoubleLE(at + 8 + 8 * k)),
        quat: [0, 1, 2, 3].map((k) => bytes.readFloatLE(at + 32 + 4 * k)),
      });
    }
    this.emit("poses", this.poses);
  }

  // Of the recent round trips the quickest says most: half of it is what each way takes.
  #ping(n) {
    const [quickest] = [...this.#trips].sort((a, b) => a.trip - b.trip);
    this.say({ type: "ping", t: this.#clock(), offset: quickest?.offset ?? null, round_trip: quickest?.trip ?? null });
    this.#pinging = setTimeout(() => this.#ping(n + 1), n < FIRST_PINGS ? FIRST_PING_MS : PING_MS);
  }

  #pong({ t, room_t: roomT }) {
    const trip = this.#clock() - t;
    this.#trips = [...this.#trips.slice(1 - QUICKEST_OF), { trip, offset: roomT - t - trip / 2 }];
  }
}

// A point of the common frame in a device's own axes. The matrix is a rotation times a scale, and a translation.
export function toOwn(matrix, [x, y, z]) {
  const moved = [x - matrix[0][3], y - matrix[1][3], z - matrix[2][3]];
  const squared = matrix[0][0] ** 2 + matrix[1][0] ** 2 + matrix[2][0] ** 2;
  return [0, 1, 2].map((k) => moved.reduce((sum, value, row) => sum + matrix[row][k] * value, 0) / squared);
}

// s by a clock that nobody sets, as phones have it: it need not agree with the room's.
export const monotonic = () => performance.now() / 1000;

// What TLS has to be told of a server: nothing where its certificate is vouched for, else to take this one alone.
function trust(url) {
  return new Promise((resolve, reject) => {
    const socket = tls.connect({ host: url.hostname, port: url.port || 443, rejectUnauthorized: false }, () => {
      const { raw } = socket.getPeerCertificate();
      const pem = `-----BEGIN CERTIFICATE-----\n${raw.toString("base64")}\n-----END CERTIFICATE-----\n`;
      resolve(socket.authorized ? {} : { ca: pem, checkServerIdentity: () => undefined });
      socket.end();
    });
    socket.on("error", reject);
  });
}

async function post(url, body, trusted) {
  const request = (url.startsWith("https:") ? https : http).request(url, { method: "POST", ...trusted });
  request.end(JSON.stringify(body));
  const [response] = await heard(request, "response");
  let text = "";
  for await (const part of response.setEncoding("utf8")) text += part;
  const answer = JSON.parse(text);
  if (response.statusCode !== 200) throw new Error(answer.what);
  return answer;
}

function heard(emitter, event) {
  return new Promise((resolve, reject) => {
    emitter.once(event, (...what) => resolve(what));
    emitter.once("error", reject);
  });
}
