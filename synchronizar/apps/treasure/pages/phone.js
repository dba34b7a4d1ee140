/** Treasure on a phone: things in place, buttons to build, the score while one plays, and ghosts of who was there. */

import {
  ConeGeometry,
  CylinderGeometry,
  Group,
  Mesh,
  MeshStandardMaterial,
  SphereGeometry,
  TorusGeometry,
} from "../../pages/vendor/three/three.module.min.js";

import { element, say } from "../../pages/dom.js";
import { Sound } from "../../pages/sound.js";
import { dispose, label } from "../../pages/xr/label.js";
import { COLOURS, GHOST, NAMES, SCORE, THING, ghostAt, ofKind, scoreOf, words } from "./model.js";

const SHAPES = {
  coin: new CylinderGeometry(0.1, 0.1, 0.02, 32),
  rusted: new CylinderGeometry(0.1, 0.1, 0.02, 7),
  obstacle: new ConeGeometry(0.2, 0.6, 24).rotateX(Math.PI / 2),
  start: new TorusGeometry(0.45, 0.03, 12, 48),
};
const TURNS = 1.5;
const SOUNDS = {
  coin: [{ hz: 880, s: 0.07 }, { hz: 1320, s: 0.18 }],
  rusted: [{ hz: 300, to: 200, s: 0.25, shape: "sawtooth", volume: 0.08 }],
  obstacle: [{ hz: 120, to: 60, s: 0.3, volume: 0.25 }],
};

/** `place`: what the phone's page has, see docs/apps.md. */
export function begin(place) {
  return new Layer(place);
}

class Layer {
  #place;
  #sound = new Sound();
  #shown = new Map();
  #ghosts = new Map();
  #turned = 0;
  #head = element("p", { class: "app-score" });
  #line = element("p", { class: "app-line", role: "status" });
  #build = element("div", { class: "app-row" });
  #play = element("button", { type: "button", class: "main", text: "Play" });
  #stop = element("button", { type: "button", text: "Back to building" });
  #new = element("button", { type: "button", text: "Begin a new game" });
  #heard;

  constructor(place) {
    this.#place = place;
    this.kinds = new Set([THING, SCORE, GHOST]);
    for (const what of Object.keys(NAMES)) this.#button(NAMES[what], () => this.#say("put", { what }));
    this.#button("Take away", () => this.#say("take"));
    this.#button("Undo", () => this.#say("undo"));
    for (const [button, word] of [[this.#play, "play"], [this.#stop, "build"], [this.#new, "new"]]) {
      button.addEventListener("click", () => this.#say(word));
    }
    place.panel.append(
      element("div", { class: "app-told" }, this.#head, this.#line),
      this.#build,
      element("div", { class: "app-row" }, this.#play, this.#stop, this.#new, this.#sound.button()),
    );
    this.#heard = ({ detail: { topic, data, by } }) => {
      if (by === "app" && topic === "met" && data.by === place.name) this.#sound.play(SOUNDS[data.what] ?? []);
    };
    place.client.addEventListener("said", this.#heard);
  }

  /** Where things are drawn, in the common frame; for tests. */
  get places() {
    return Object.fromEntries([...this.#shown].map(([id, mesh]) => [id, mesh.position.toArray()]));
  }

  update(dt, roomTime) {
    const { client, name, registered } = this.#place;
    const score = scoreOf(client);
    const { head, line } = words(score, name);
    const ready = registered() && Boolean(score?.found);
    const playing = ready && score.playing !== null;
    say(this.#head, head);
    say(this.#line, registered() ? line : "");
    this.#build.hidden = !ready || playing;
    this.#play.hidden = !ready || playing || !ofKind(client, THING).some(({ data }) => data.what === "coin");
    this.#stop.hidden = !playing;
    this.#new.hidden = !registered() || !score || score.found;
    this.#turned += dt;
    this.#things();
    this.#walks(roomTime);
  }

  end() {
    const { client, common, panel } = this.#place;
    client.removeEventListener("said", this.#heard);
    for (const mesh of this.#shown.values()) common.remove(mesh);
    for (const { root } of this.#ghosts.values()) common.remove(root);
    panel.replaceChildren();
  }

  #things() {
    const { client, common } = this.#place;
    const now = ofKind(client, THING);
    const ids = new Set(now.map(({ id }) => id));
    for (const { id, position, data } of now) {
      let mesh = this.#shown.get(id);
      if (!mesh) {
        mesh = new Mesh(SHAPES[data.what], new MeshStandardMaterial({ color: COLOURS[data.what], roughness: 0.4 }));
        this.#shown.set(id, mesh);
        common.add(mesh);
      }
      mesh.position.set(...position);
      if (data.what === "coin" || data.what === "rusted") mesh.rotation.set(0, 0, TURNS * this.#turned);
    }
    for (const [id, mesh] of this.#shown) {
      if (ids.has(id)) continue;
      common.remove(mesh);
      mesh.material.dispose();
      this.#shown.delete(id);
    }
  }

  #walks(roomTime) {
    const { client, common } = this.#place;
    const now = new Map(ofKind(client, GHOST).map(({ id, data }) => [id, data]));
    for (const [id, data] of now) {
      if (!this.#ghosts.has(id)) this.#ghosts.set(id, ghost(data.name, common));
      const { root } = this.#ghosts.get(id);
      const at = roomTime === null ? null : ghostAt(data, roomTime);
      root.visible = at !== null;
      if (at) root.position.set(...at);
    }
    for (const [id, { root, tag }] of this.#ghosts) {
      if (now.has(id)) continue;
      common.remove(root);
      dispose(tag);
      this.#ghosts.delete(id);
    }
  }

  #button(text, act) {
    const button = element("button", { type: "button", text });
    button.addEventListener("click", act);
    this.#build.append(button);
  }

  #say(topic, data = null) {
    this.#place.client.say(topic, data, "app");
  }
}

function ghost(name, common) {
  const material = new MeshStandardMaterial({ color: 0xffffff, transparent: true, opacity: 0.35, depthWrite: false });
  const tag = label(`${name}, then`, "#ffffff");
  tag.position.set(0, 0, 0.28);
  const root = new Group();
  root.add(new Mesh(new SphereGeometry(0.13, 24, 16), material), tag);
  common.add(root);
  return { root, tag };
}
