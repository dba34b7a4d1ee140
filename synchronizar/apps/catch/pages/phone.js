/** Catch on a phone: the ball in place, a button to throw it, the score. */

import {
  BufferGeometry,
  Float32BufferAttribute,
  Line,
  LineBasicMaterial,
  Mesh,
  MeshStandardMaterial,
  SphereGeometry,
} from "../../pages/vendor/three/three.module.min.js";

import { commonFromDevice, deviceFromPoint } from "../../pages/axes.js";
import { element, say } from "../../pages/dom.js";
import { Sound } from "../../pages/sound.js";
import { BALL, SCORE, Shown, arc, flown, handOf, swing, thrown, wayTo, words } from "./ball.js";
import { soundOf } from "./sounds.js";

const RADIUS_M = 0.09;
const KEPT = 30;

/** `place`: what the phone's page has, see docs/apps.md. */
export function begin(place) {
  return new Layer(place);
}

class Layer {
  #place;
  #sound = new Sound();
  #shown = new Shown();
  #places = [];
  #holding = false;
  #phase = "";
  #line = element("p", { class: "app-line", role: "status" });
  #score = element("p", { class: "app-score" });
  #throw = element("button", { type: "button", class: "app-act", text: "Throw" });
  #ball = new Mesh(new SphereGeometry(RADIUS_M, 32, 24), new MeshStandardMaterial({ color: 0xf58a1f, roughness: 0.45 }));
  #arc = new Line(new BufferGeometry(), new LineBasicMaterial({ color: 0xf5c26b, transparent: true, opacity: 0.7 }));

  constructor(place) {
    this.#place = place;
    this.kinds = new Set([BALL, SCORE]);
    place.panel.append(element("div", { class: "app-told" }, this.#score, this.#line), this.#throw, this.#sound.button());
    place.common.add(this.#ball, this.#arc);
    this.#ball.visible = this.#arc.visible = false;
    this.#throw.addEventListener("pointerdown", () => (this.#holding = true));
    this.#throw.addEventListener("click", () => this.#letGo());
    this.select = { start: () => (this.#holding = true), end: () => this.#letGo() };
    /** Where the ball is drawn now, in the common frame; for tests. */
    this.at = null;
  }

  /** The phone is there, `t` ms by the page's clock, in its own axes. */
  pose(t, position) {
    this.#places.push({ t, position });
    if (this.#places.length > KEPT) this.#places.shift();
  }

  update(dt, roomTime) {
    const { client, name, registered } = this.#place;
    const [ball, score] = [client.objects.get(BALL), client.objects.get(SCORE)];
    const told = words(score, ball, name, this.#way());
    const mine = ball?.data.phase === "held" && ball.data.by === name;
    say(this.#score, ball || told.best ? `Rally ${told.rally} · Best ${told.best}` : "");
    say(this.#line, registered() ? told.line : "");
    this.#throw.hidden = !mine;
    this.#hear(ball?.data.phase ?? "");
    const goal = ball && roomTime !== null ? this.#goal(ball, roomTime) : null;
    this.#ball.visible = goal !== null;
    this.#arc.visible = goal !== null && ball.data.phase === "flies" && score !== undefined;
    if (goal === null) {
      this.at = null;
      this.#shown.forget();
      return;
    }
    this.at = this.#shown.step(dt, `${ball.data.phase} ${ball.data.by}`, goal);
    this.#ball.position.set(...this.at);
    if (this.#arc.visible) {
      const points = arc(ball.data, roomTime, score.data.floor);
      this.#arc.geometry.setAttribute("position", new Float32BufferAttribute(points.flat(), 3));
    }
  }

  /** To the ball as it is drawn, in words. */
  #way() {
    const { frame, own } = this.#place;
    const here = own();
    if (!this.at || !here || !frame.placing) return "";
    return wayTo(here.position, here.quat_xyzw, deviceFromPoint(frame.placing, this.at));
  }

  end() {
    this.#place.common.remove(this.#ball, this.#arc);
    this.#place.panel.replaceChildren();
  }

  /** Where it is in the common frame, as far as this page knows. */
  #goal({ position, data }, roomTime) {
    if (data.phase === "flies") return flown(data, roomTime);
    if (data.phase === "lies") return position;
    const { avatars, client, frame, name, own } = this.#place;
    if (data.by === name) {
      const [here, placing] = [own(), frame.placing];
      return here && placing ? commonFromDevice(placing, handOf(here.position, here.quat_xyzw, "y")) : null;
    }
    const there = avatars.placeOf(data.by);
    return there ? handOf(there.position, there.quat_xyzw, client.member(data.by)?.up ?? "y") : position;
  }

  #letGo() {
    const { client, frame, name, own } = this.#place;
    const [ball, here, placing] = [client.objects.get(BALL), own(), frame.placing];
    const mine = ball?.data.phase === "held" && ball.data.by === name;
    const held = this.#holding;
    this.#holding = false;
    if (!mine || !held || !here || !placing) return;
    const velocity = thrown(here.quat_xyzw, swing(this.#places), [0, 1, 0]);
    const [to, from] = [velocity, [0, 0, 0]].map((point) => commonFromDevice(placing, point));
    client.say("throw", { velocity: to.map((v, i) => (v - from[i]) / placing.scale) }, "app");
  }

  #hear(phase) {
    const sound = soundOf(this.#phase, phase);
    if (phase !== this.#phase && this.#phase && sound) this.#sound.play(sound);
    this.#phase = phase;
  }
}
