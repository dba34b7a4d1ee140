/**
 * WebTransport with a WebSocket's face: words on one stream, each with its length (u32, little-endian) before it, poses
 * as datagrams that nobody waits for. synchronizar/live/webtransport.py is the other end.
 */

const LARGEST_WORD = 1 << 20;
const OPEN_WITHIN_MS = 3000;

export class WebTransportSocket {
  #transport;
  #words = null;
  #datagrams = null;
  #waiting = 0;
  #ended = false;

  /** `address`: https://host:port/live; `sha256`: hash of its certificate, in hex. */
  constructor(address, sha256, WebTransport = globalThis.WebTransport) {
    this.onopen = this.onmessage = this.onclose = null;
    const value = Uint8Array.from(sha256.match(/../g), (byte) => parseInt(byte, 16));
    this.#transport = new WebTransport(address, {
      serverCertificateHashes: [{ algorithm: "sha-256", value }],
      congestionControl: "low-latency",
    });
    this.#run();
  }

  /** Bytes that were given to the browser and not yet sent. */
  get bufferedAmount() {
    return this.#waiting;
  }

  /** A word (string), or poses (ArrayBuffer). */
  send(data) {
    if (this.#ended || !this.#words) return;
    const bytes = typeof data === "string" ? withLength(new TextEncoder().encode(data)) : new Uint8Array(data);
    const writer = typeof data === "string" ? this.#words : this.#datagrams;
    this.#waiting += bytes.byteLength;
    writer.write(bytes).then(
      () => (this.#waiting -= bytes.byteLength),
      () => this.#end(),
    );
  }

  close() {
    this.#end();
  }

  async #run() {
    const transport = this.#transport;
    try {
      const late = new Promise((_, reject) => setTimeout(() => reject(new Error("it takes too long")), OPEN_WITHIN_MS));
      await Promise.race([transport.ready, late]);
      const stream = await transport.createBidirectionalStream();
      this.#words = stream.writable.getWriter();
      this.#datagrams = (transport.datagrams.createWritable?.() ?? transport.datagrams.writable).getWriter();
      this.onopen?.();
      const heard = (data) => this.#ended || this.onmessage?.({ data });
      readWords(stream.readable, heard).catch(() => {}).finally(() => this.#end());
      readDatagrams(transport.datagrams.readable, heard).catch(() => {});
      await transport.closed;
    } catch {
      // Told by `onclose`, as a WebSocket does.
    }
    this.#end();
  }

  #end() {
    if (this.#ended) return;
    this.#ended = true;
    try {
      this.#transport.close();
    } catch {
      // It has ended already.
    }
    this.onclose?.();
  }
}

function withLength(bytes) {
  const whole = new Uint8Array(4 + bytes.byteLength);
  new DataView(whole.buffer).setUint32(0, bytes.byteLength, true);
  whole.set(bytes, 4);
  return whole;
}

/** Words of a stream, wherever its pieces are cut. */
export async function readWords(readable, heard) {
  const reader = readable.getReader();
  let rest = new Uint8Array(0);
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    const bytes = new Uint8Array(rest.byteLength + value.byteLength);
    bytes.set(rest);
    bytes.set(value, rest.byteLength);
    const view = new DataView(bytes.buffer);
    let at = 0;
    while (bytes.byteLength - at >= 4) {
      const size = view.getUint32(at, true);
      if (size > LARGEST_WORD) throw new RangeError("a word that is too long");
      if (bytes.byteLength - at < 4 + size) break;
      heard(new TextDecoder().decode(bytes.subarray(at + 4, at + 4 + size)));
      at += 4 + size;
    }
    rest = bytes.slice(at);
  }
}

async function readDatagrams(readable, heard) {
  const reader = readable.getReader();
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    heard(value);
  }
}
