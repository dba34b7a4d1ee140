/**
 * Video from one browser to another, by WebRTC; the room hands the signalling on. Who is seen offers a stream to each
 * who may look.
 */

const TOPIC = "stream";

/** Streams to others, and those from them. */
export class Streams {
  #client;
  #stream = null;
  #to = new Map();
  #from = new Map();
  #heard;

  constructor(client) {
    this.#client = client;
    this.#heard = ({ detail: { by, data } }) => data?.topic === TOPIC && this.#signalled(by, data);
    client.addEventListener("signalled", this.#heard);
  }

  /** Show `canvas` to those of these names, and to nobody else. */
  showTo(names, canvas) {
    for (const [name, peer] of this.#to) {
      if (names.includes(name)) continue;
      peer.close();
      this.#to.delete(name);
    }
    if (!names.length) {
      this.#stream?.getTracks().forEach((track) => track.stop());
      this.#stream = null;
      return;
    }
    if (!globalThis.RTCPeerConnection || !canvas.captureStream) return;
    this.#stream ??= canvas.captureStream(15);
    for (const name of names) if (!this.#to.has(name)) this.#offer(name);
  }

  /** Whether somebody gets the video. */
  reaches(name) {
    return this.#to.get(name)?.connectionState === "connected";
  }

  /** The <video> of somebody's stream; null where there is none. */
  of(name) {
    const found = this.#from.get(name);
    return found?.peer.connectionState === "connected" && found.video.readyState >= 2 ? found.video : null;
  }

  /** Somebody's stream is not wanted any more. */
  drop(name) {
    this.#from.get(name)?.peer.close();
    this.#from.delete(name);
  }

  end() {
    this.showTo([], null);
    for (const name of [...this.#from.keys()]) this.drop(name);
    this.#client.removeEventListener("signalled", this.#heard);
  }

  async #offer(name) {
    const peer = this.#peer(name);
    this.#to.set(name, peer);
    for (const track of this.#stream.getTracks()) peer.addTrack(track, this.#stream);
    await peer.setLocalDescription();
    this.#say(name, { offer: peer.localDescription.sdp });
  }

  async #signalled(by, { offer, answer, candidate, to }) {
    if (offer) {
      this.drop(by);
      const video = Object.assign(document.createElement("video"), { muted: true, autoplay: true, playsInline: true });
      const peer = this.#peer(by, true);
      this.#from.set(by, { peer, video });
      peer.ontrack = ({ streams: [stream] }) => {
        video.srcObject = stream;
        video.play().catch(() => {});
      };
      await peer.setRemoteDescription({ type: "offer", sdp: offer });
      await peer.setLocalDescription();
      this.#say(by, { answer: peer.localDescription.sdp });
      return;
    }
    const peer = to ? this.#from.get(by)?.peer : this.#to.get(by);
    if (!peer) return;
    if (answer) await peer.setRemoteDescription({ type: "answer", sdp: answer });
    else if (candidate) await peer.addIceCandidate(candidate).catch(() => {});
  }

  #peer(name, from = false) {
    const peer = new RTCPeerConnection();
    // `to`: the candidate is of who shows, for the connection of who looks.
    peer.onicecandidate = ({ candidate }) => candidate && this.#say(name, { candidate: candidate.toJSON(), to: !from });
    return peer;
  }

  #say(name, data) {
    this.#client.signal(name, { topic: TOPIC, ...data });
  }
}
