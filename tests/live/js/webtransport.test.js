import assert from "node:assert/strict";
import { test } from "node:test";

import { PAGES, fakeNetwork, welcome } from "./support.js";

const { RoomClient } = await import(new URL("protocol.js", PAGES));
const { readWords } = await import(new URL("webtransport.js", PAGES));
const IDENTITY = [0, 0, 0, 1];
const JOINED = { webtransport_port: 4433, webtransport_sha256: "00ff10" };

function framed(text) {
  const bytes = new TextEncoder().encode(text);
  const whole = new Uint8Array(4 + bytes.byteLength);
  new DataView(whole.buffer).setUint32(0, bytes.byteLength, true);
  whole.set(bytes, 4);
  return whole;
}

/** A browser's WebTransport, with the room's end of it in the test's hands. */
function fakeTransport(works = true) {
  const sessions = [];
  class FakeTransport {
    constructor(address, options) {
      const words = new TransformStream();
      const answers = new TransformStream();
      const up = new TransformStream();
      const down = new TransformStream();
      Object.assign(this, { address, options, answers: answers.writable.getWriter(), down: down.writable.getWriter() });
      this.ready = works ? Promise.resolve() : Promise.reject(new Error("no UDP here"));
      this.closed = new Promise((resolve) => (this.close = resolve));
      this.datagrams = { writable: up.writable, readable: down.readable };
      this.poses = up.readable.getReader();
      this.heard = [];
      readWords(words.readable, (word) => this.heard.push(JSON.parse(word))).catch(() => {});
      this.createBidirectionalStream = async () => ({ writable: words.writable, readable: answers.readable });
      sessions.push(this);
    }
  }
  return { sessions, WebTransport: FakeTransport };
}

async function until(done) {
  for (let k = 0; k < 200 && !done(); k++) await new Promise((resolve) => setTimeout(resolve, 5));
  assert.ok(done());
}

test("words that are cut anywhere are read whole", async () => {
  const both = [...framed('{"a":1}'), ...framed("ä")];
  for (const cut of [1, 3, 4, 7, 12, 16]) {
    const { readable, writable } = new TransformStream();
    const heard = [];
    const reading = readWords(readable, (word) => heard.push(word));
    const writer = writable.getWriter();
    for (const part of [both.slice(0, cut), both.slice(cut)]) await writer.write(Uint8Array.from(part));
    await writer.close();
    await reading;
    assert.deepEqual(heard, ['{"a":1}', "ä"]);
  }
});

test("where the server has WebTransport, words go by its stream and poses by datagrams", async () => {
  const { sessions, WebTransport } = fakeTransport();
  const { WebSocket, fetch, sockets } = fakeNetwork({ joined: JOINED });
  const options = { server: "https://room.example:1/a", room: "CODE", users: [{ name: "ann" }] };
  const client = new RoomClient({ ...options, WebSocket, WebTransport, fetch });
  const welcomed = client.connect();
  await until(() => sessions[0]?.heard.length);
  const [session] = sessions;
  assert.equal(session.address, "https://room.example:4433/a/live");
  assert.deepEqual([...session.options.serverCertificateHashes[0].value], [0, 255, 16]);
  assert.deepEqual(session.heard[0], { type: "hello", token: "token 1", protocol: 1 });
  await session.answers.write(framed(JSON.stringify(welcome(["ann"]))));
  await welcomed;
  assert.equal(client.transport, "webtransport");
  client.sendPose([1, 2, 3], IDENTITY, 50);
  const { value } = await session.poses.read();
  assert.equal(value.byteLength, 56);
  assert.equal(sockets.length, 0);
  client.close();
  await session.closed;
});

test("where no UDP comes through, a WebSocket takes its place with the same token", async () => {
  const { WebTransport } = fakeTransport(false);
  const { WebSocket, fetch, sockets, joins } = fakeNetwork({ joined: JOINED });
  const client = new RoomClient({ server: "https://room.example:1", room: "CODE", WebSocket, WebTransport, fetch });
  const welcomed = client.connect();
  await until(() => sockets.length);
  sockets[0].onopen();
  sockets[0].say(welcome([]));
  await welcomed;
  assert.equal(client.transport, "websocket");
  assert.equal(sockets[0].sent[0].token, "token 1");
  assert.equal(joins.length, 1);
  client.close();
});

test("poses that were overtaken are left out, parts of the same are not", async () => {
  const { WebSocket, fetch, sockets } = fakeNetwork();
  const client = new RoomClient({ server: "https://room.example:1", room: "CODE", WebSocket, fetch, webTransport: false });
  const welcomed = client.connect();
  await until(() => sockets.length);
  sockets[0].onopen();
  sockets[0].say(welcome([]));
  await welcomed;
  const heard = [];
  client.addEventListener("poses", ({ detail }) => heard.push(detail.sequence));
  for (const sequence of [0xfffffffe, 0xfffffffe, 0xffffffff, 0, 0xffffffff, 1]) {
    const bytes = new ArrayBuffer(16);
    const view = new DataView(bytes);
    view.setUint8(0, 2);
    view.setUint32(4, sequence, true);
    sockets[0].say(bytes);
  }
  assert.deepEqual(heard, [0xfffffffe, 0xfffffffe, 0xffffffff, 0, 1]);
  client.close();
});
