/** The common frame in three dimensions, for who looks at it on a laptop: one walks about in it, by keys or a pointer. */

import {
  Color,
  DirectionalLight,
  GridHelper,
  Group,
  HemisphereLight,
  PerspectiveCamera,
  Quaternion,
  Raycaster,
  Scene,
  Vector2,
  WebGLRenderer,
} from "../vendor/three/three.module.min.js";

import { Z_UP_FROM_Y_UP } from "../axes.js";
import { Avatars } from "../xr/avatars.js";

/** m/s, and rad a pixel that is dragged. */
const WALK = 1.6;
const TURN = 0.005;
const STEEPEST = 1.5;
const KEYS = {
  KeyW: [1, 0, 0],
  ArrowUp: [1, 0, 0],
  KeyS: [-1, 0, 0],
  ArrowDown: [-1, 0, 0],
  KeyA: [0, 1, 0],
  ArrowLeft: [0, 1, 0],
  KeyD: [0, -1, 0],
  ArrowRight: [0, -1, 0],
  KeyE: [0, 0, 1],
  PageUp: [0, 0, 1],
  KeyQ: [0, 0, -1],
  PageDown: [0, 0, -1],
};

export class SpaceView {
  #client;
  #renderer = new WebGLRenderer({ antialias: true });
  #scene = new Scene();
  #camera = new PerspectiveCamera(60, 1, 0.05, 200);
  #caster = new Raycaster();
  #avatars;
  #eye = [-4, -4, 2];
  #yaw = Math.PI / 4;
  #pitch = -0.45;
  #pressed = new Set();
  #grid = new GridHelper(20, 20, 0x667788, 0x445566).rotateX(Math.PI / 2);
  #drawn = null;
  #dragged = 0;

  /** `canvas` is its own element. `pointed(origin, way)` hears a click: a ray in the common frame. */
  constructor(client, pointed) {
    this.#client = client;
    this.canvas = this.#renderer.domElement;
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.common = new Group();
    this.#scene.add(this.common, new HemisphereLight(0xffffff, 0x8899aa, 2.4));
    const sun = new DirectionalLight(0xffffff, 1.4);
    sun.position.set(2, -3, 5);
    this.#scene.add(sun, this.#grid);
    this.#scene.background = new Color(0x11161b);
    this.#camera.up.set(0, 0, 1);
    this.#avatars = new Avatars(client, this.common);
    this.#hear(pointed);
    /** Whose eyes one looks by: {position, quat_xyzw, up}, or null: one's own. Asked with each frame. */
    this.by = () => null;
    /** Called with each frame before it is drawn: (dt, roomTime). */
    this.update = () => {};
    requestAnimationFrame((time) => this.#draw(time));
  }

  /** m, common frame: how high the floor is, on which there is a grid of metres. */
  set floor(z) {
    this.#grid.position.z = z;
  }

  /** {origin, way} in the common frame of what a place of the picture shows, -1 to 1 to the right and up. */
  ray(right = 0, up = 0) {
    this.#caster.setFromCamera(new Vector2(right, up), this.#camera);
    const { origin, direction } = this.#caster.ray;
    return { origin: origin.toArray(), way: direction.toArray() };
  }

  /** Where somebody is drawn, {position, quat_xyzw}; null of who is not. */
  placeOf(name) {
    return this.#avatars.placeOf(name);
  }

  #hear(pointed) {
    const { canvas } = this;
    canvas.addEventListener("keydown", (event) => {
      if (!KEYS[event.code]) return;
      event.preventDefault();
      this.#pressed.add(event.code);
    });
    canvas.addEventListener("keyup", ({ code }) => this.#pressed.delete(code));
    canvas.addEventListener("blur", () => this.#pressed.clear());
    canvas.addEventListener("pointerdown", ({ pointerId }) => {
      canvas.setPointerCapture(pointerId);
      this.#dragged = 0;
    });
    canvas.addEventListener("pointermove", ({ buttons, movementX, movementY }) => {
      if (!buttons) return;
      this.#dragged += Math.abs(movementX) + Math.abs(movementY);
      this.#yaw += TURN * movementX;
      this.#pitch = Math.max(-STEEPEST, Math.min(STEEPEST, this.#pitch + TURN * movementY));
    });
    canvas.addEventListener("pointerup", ({ offsetX, offsetY }) => {
      if (this.#dragged > 4) return;
      const { origin, way } = this.ray((2 * offsetX) / canvas.clientWidth - 1, 1 - (2 * offsetY) / canvas.clientHeight);
      pointed(origin, way);
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.#go([-Math.sign(event.deltaY) * 0.25, 0, 0]);
    });
  }

  /** m ahead, to the left and up. */
  #go([ahead, left, up]) {
    const [c, s] = [Math.cos(this.#yaw), Math.sin(this.#yaw)];
    const steps = [ahead * c - left * s, ahead * s + left * c, up + ahead * Math.tan(this.#pitch)];
    this.#eye = this.#eye.map((v, i) => v + steps[i]);
  }

  #draw(time) {
    requestAnimationFrame((next) => this.#draw(next));
    const { canvas } = this;
    if (!canvas.isConnected || !canvas.clientWidth) return;
    const dt = this.#drawn === null ? 0 : Math.min(0.1, (time - this.#drawn) / 1000);
    this.#drawn = time;
    for (const code of this.#pressed) this.#go(KEYS[code].map((v) => v * WALK * dt));
    this.#fit();
    const { roomTime } = this.#client;
    if (roomTime !== null) this.#avatars.update(roomTime, 1);
    this.#stand();
    this.update(dt, roomTime);
    this.#renderer.render(this.#scene, this.#camera);
  }

  #stand() {
    const by = this.by();
    if (by) {
      this.#camera.position.set(...by.position);
      this.#camera.quaternion.set(...by.quat_xyzw);
      if (by.up === "z") this.#camera.quaternion.multiply(new Quaternion(...Z_UP_FROM_Y_UP));
      return;
    }
    const [x, y, z] = this.#eye;
    const level = Math.cos(this.#pitch);
    this.#camera.position.set(x, y, z);
    this.#camera.lookAt(x + level * Math.cos(this.#yaw), y + level * Math.sin(this.#yaw), z + Math.sin(this.#pitch));
  }

  #fit() {
    const { clientWidth, clientHeight } = this.canvas;
    const size = this.#renderer.getSize(new Vector2());
    if (size.x === clientWidth && size.y === clientHeight) return;
    this.#renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    this.#renderer.setSize(clientWidth, clientHeight, false);
    this.#camera.aspect = clientWidth / clientHeight;
    this.#camera.updateProjectionMatrix();
  }
}
