import assert from "node:assert/strict";
import { mock, test } from "node:test";

import { PAGES, fakeNetwork, settled, vectors, welcome } from "./support.js";

const { JoinError, MOST_BUFFERED, RoomClient } = await import(new URL("protocol.js", PAGES));
const { PlayedClock } = await import(new URL("clock.js", PAGES));
const IDENTITY = [0, 0, 0, 1];

/** A client whose clock and timers the test drives, connected unless `refused`. */
async function connected(t, { users = [{ name: "ann", up: "y" }], network = fakeNetwork(), first, ...options } = {}) {
  mock.timers.enable({ apis: ["setTimeout"] });
  t.after(() => mock.timers.reset());
  const clock = { now: 50 };
  const { WebSocket, fetch } = network;
  const server = "https://room.example:1";
  const client = new RoomClient({ server, room: "CODE", users, now: () => clock.now, WebSocket, fetch, ...options });
  const states = [];
  client.addEventListener("state", ({ detail }) => states.push(detail.state));
  const welcomed = client.connect();
  await settled();
  network.sockets[0].onopen();
  network.sockets[0].say(first ?? welcome(users.map((user) => user.name)));
  await welcomed;
  const pass = async (seconds) => {
    clock.now += seconds;
    mock.timers.tick(1000 * seconds);
    await settled();
  };
  return { client, clock, pass, states, ...network, socket: network.sockets[0] };
}

test("the room's code goes into the body, the token into the first message, neither into an address", async (t) => {
  const { joins, socket, states } = await connected(t);
  assert.deepEqual(joins, [
    { address: "https://room.example:1/api/join", room: "CODE", users: [{ name: "ann", up: "y" }], resume: null },
  ]);
  assert.equal(socket.address, "wss://room.example:1/live");
  assert.deepEqual(socket.sent[0], { type: "hello", token: "token 1", protocol: 1 });
  assert.deepEqual(states, ["joining", "open"]);
});

test("who is not let in is told why", async () => {
  const { WebSocket, fetch } = fakeNetwork({ refuse: [{ reason: "room", what: "there is no room with that code" }] });
  const client = new RoomClient({ server: "http://localhost:1", room: "X", WebSocket, fetch });
  await assert.rejects(client.connect(), (error) => error instanceof JoinError && error.reason === "room");
  assert.equal(client.state, "closed");
});

test("a server that does not answer is told in a sentence", async () => {
  const { WebSocket, fetch } = fakeNetwork({ refuse: ["network"] });
  const client = new RoomClient({ server: "http://localhost:1", room: "X", WebSocket, fetch });
  await assert.rejects(client.connect(), /does not answer/);
});

test("the quickest of the pings says how far the room's clock is ahead", async (t) => {
  const { client, clock, socket } = await connected(t);
  clock.now = 50.5;
  socket.say({ type: "pong", t: 50, room_t: 1050.4 });
  assert.ok(Math.abs(client.roomTime - (50.5 + 1000.15)) < 1e-9);
  clock.now = 60.02;
  socket.say({ type: "pong", t: 60, room_t: 1060.01 });
  assert.ok(Math.abs(client.roomTime - 1060.02) < 1e-9);
  assert.ok(Math.abs(client.roundTrip - 0.02) < 1e-9);
});

test("four pings at first, then one every two seconds, with what is known", async (t) => {
  const { socket, pass, clock } = await connected(t);
  for (let i = 0; i < 3; i++) await pass(0.1);
  assert.equal(socket.words("ping").length, 4);
  await pass(1.9);
  assert.equal(socket.words("ping").length, 4);
  socket.say({ type: "pong", t: clock.now - 0.01, room_t: clock.now + 7 });
  await pass(0.11);
  assert.equal(socket.words("ping").length, 5);
  assert.ok(Math.abs(socket.words("ping")[4].offset - 7.005) < 1e-9);
});

test("a pose has the member's frame and a number that rises", async (t) => {
  const members = [{ name: "ann", index: 4, up: "y", frame: 3 }];
  const { client, socket } = await connected(t, { first: welcome(["ann"], { members }) });
  client.sendPose([1, 2, 3], IDENTITY, 50);
  client.sendPose([1, 2, 4], IDENTITY, 50.1);
  const views = socket.poses.map((bytes) => new DataView(bytes));
  assert.deepEqual(views.map((view) => view.getUint8(1)), [3, 3]);
  assert.deepEqual(views.map((view) => view.getUint32(4, true)), [0, 1]);
});

test("where the network is slower than poses come, the latest is sent and those before it are not", async (t) => {
  const { client, socket, pass } = await connected(t);
  socket.bufferedAmount = MOST_BUFFERED + 1;
  for (let k = 0; k < 10_000; k++) client.sendPose([k, 0, 0], IDENTITY, 50 + k / 60);
  await pass(0.02);
  assert.equal(socket.poses.length, 0);
  socket.bufferedAmount = 0;
  await pass(0.02);
  assert.deepEqual(socket.poses.map((bytes) => new DataView(bytes).getFloat64(16, true)), [9999]);
});

test("a new frame is told, and poses carry its number from then on", async (t) => {
  const { client, socket } = await connected(t);
  client.reset();
  client.sendPose([0, 0, 0], IDENTITY, 50);
  assert.deepEqual(socket.words("reset"), [{ type: "reset", user: "ann", frame: 1 }]);
  assert.equal(new DataView(socket.poses[0]).getUint8(1), 1);
});

test("after a reload a device is the same one in another frame", async (t) => {
  const { joins, socket } = await connected(t, {
    resume: "secret",
    first: welcome(["ann"], { members: [{ name: "ann", index: 0, frame: 255 }] }),
  });
  assert.equal(joins[0].resume, "secret");
  assert.deepEqual(socket.words("reset"), [{ type: "reset", user: "ann", frame: 0 }]);
});

test("a broken connection is made anew as the same device in the same frame, and words that waited are said", async (t) => {
  const { client, joins, sockets, socket, states, pass } = await connected(t);
  socket.onclose();
  assert.equal(client.state, "waiting");
  client.create({ id: "cup", kind: "marker", position: [0, 0, 0] });
  client.sendPose([0, 0, 0], IDENTITY, 50);
  await pass(0.4);
  assert.equal(joins[1].resume, "again");
  sockets[1].say(welcome(["ann"]));
  assert.deepEqual(states, ["joining", "open", "waiting", "joining", "open"]);
  assert.deepEqual(sockets[1].words("create").map((word) => word.id), ["cup"]);
  assert.deepEqual(sockets[1].words("reset"), []);
  assert.equal(sockets[1].poses.length, 0);
});

test("tries go on, ever slower, while the server does not answer", async (t) => {
  const network = fakeNetwork();
  const { joins, socket, client, pass } = await connected(t, { network });
  socket.onclose();
  for (let k = 0; k < 8; k++) {
    await pass(7);
    network.sockets.at(-1).onclose();
  }
  assert.equal(joins.length, 9);
  assert.equal(client.state, "waiting");
});

test("a room that is gone is not asked again", async (t) => {
  const network = fakeNetwork({ refuse: [undefined, { reason: "room", what: "there is no room with that code" }] });
  const { client, socket, states, pass } = await connected(t, { network });
  socket.onclose();
  await pass(1);
  assert.equal(client.state, "closed");
  assert.deepEqual(states.slice(-1), ["closed"]);
});

test("a connection without an answer is taken for broken", async (t) => {
  const { client, pass } = await connected(t);
  for (let k = 0; k < 12 && client.state === "open"; k++) await pass(1);
  assert.equal(client.state, "waiting");
});

test("a room that does not welcome is asked again", async (t) => {
  const { joins, sockets, socket, client, pass } = await connected(t);
  socket.onclose();
  await pass(0.4);
  sockets[1].onopen();
  await pass(6);
  assert.equal(client.state, "waiting");
  await pass(1);
  assert.equal(joins.length, 3);
});

test("a bye that is final ends it, another one does not", async (t) => {
  const { client, socket } = await connected(t);
  const byes = [];
  client.addEventListener("bye", ({ detail }) => byes.push(detail.reason));
  socket.say({ type: "bye", reason: "elsewhere", what: "the same device has joined from somewhere else" });
  assert.equal(client.state, "closed");
  assert.deepEqual(byes, ["elsewhere"]);
});

test("objects are kept as they stand", async (t) => {
  const cup = { id: "cup", kind: "marker", position: [0, 0, 0], quat_xyzw: IDENTITY, by: "ann" };
  const first = welcome(["ann"], { objects: { version: 1, changed: [cup] } });
  const { client, socket } = await connected(t, { first });
  assert.equal(client.objects.get("cup").holder, null);
  socket.say({ type: "objects", version: 2, changed: [{ ...cup, holder: "ben" }] });
  assert.equal(client.objects.get("cup").holder, "ben");
  socket.say({ type: "objects", version: 3, removed: ["cup"] });
  assert.equal(client.objects.size, 0);
});

test("everybody's poses come with names", async (t) => {
  const members = [{ name: "ann", index: 0 }, { name: "ben", index: 40, up: "y" }];
  const { client, socket } = await connected(t, { first: welcome(["ann"], { members }) });
  const heard = [];
  client.addEventListener("poses", ({ detail }) => heard.push(...detail.poses.map((pose) => pose.name)));
  const { down } = await vectors("poses");
  socket.say(new Uint8Array(Buffer.from(down[1].hex, "hex")).buffer);
  assert.deepEqual(heard, ["ann", "ben"]);
});

test("what a later room says is left alone and counted", async (t) => {
  const { client, socket } = await connected(t);
  const heard = [];
  for (const type of ["weather", "state", "events"]) client.addEventListener(type, () => heard.push(type));
  socket.say({ type: "weather", rain: true });
  socket.say({ type: "weather", rain: false });
  socket.say({ type: "state", state: "closed" });
  socket.say(null);
  socket.onmessage({ data: "{" });
  socket.say(new ArrayBuffer(3));
  socket.say({ type: "events", t: 1, events: ["Ben has come"], more: "than this client knows" });
  assert.deepEqual(heard, ["events"]);
  assert.deepEqual([...client.notUnderstood], [["weather", 2], ["state", 1], ["malformed", 2], ["binary", 1]]);
  assert.equal(client.state, "open");
});

test("a recording's time goes as fast as it is played, from its first moment on, and never back", () => {
  const clock = new PlayedClock();
  assert.equal(clock.at(5), null);
  clock.heard(1.7e9, 5); // before it is played a room has its own time
  assert.equal(clock.at(5), 1.7e9);
  for (let n = 0; n <= 20; n++) clock.heard(100 + 0.1 * n, 10 + 0.025 * n);
  assert.equal(clock.at(10.5), 102);
  assert.ok(Math.abs(clock.at(10.52) - 102.08) < 0.005);
  clock.heard(102.1, 10.6);
  assert.ok(clock.at(10.6) >= 102.1);
  const stands = clock.at(60);
  assert.ok(stands < 103);
  assert.equal(clock.at(90), stands);
});

test("words of a recording that were held up and come all at once do not carry its time away", () => {
  const clock = new PlayedClock();
  for (let n = 0; n <= 20; n++) clock.heard(0.1 * n, 10 + 0.1 * n);
  for (let n = 21; n <= 50; n++) clock.heard(0.1 * n, 15 + 0.0001 * n);
  const t = clock.at(15.1);
  assert.ok(t >= 5 && t < 5.3, `${t}`);
  clock.heard(5.1, 15.1);
  assert.ok(clock.at(15.2) < 5.4);
});
