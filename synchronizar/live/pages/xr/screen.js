/**
 * What somebody sees, as a screen in space: it hangs in front of where that one is, with the edges of what its camera
 * sees. In the common frame, z up; a device looks along its own -z where it is y up, along x where z up.
 */

import {
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  Group,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  MeshBasicMaterial,
  PlaneGeometry,
  SRGBColorSpace,
  Texture,
} from "../vendor/three/three.module.min.js";

import { Z_UP_FROM_Y_UP } from "../axes.js";

/** m in front of the eyes. */
const AWAY_M = 0.7;

export class Screen {
  #shape = null;
  #texture = new Texture();
  #surface = new Mesh(new PlaneGeometry(1, 1), new MeshBasicMaterial({ side: DoubleSide, map: this.#texture, toneMapped: false }));
  #edges = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ color: 0xffd166 }));
  #body = new Group();

  constructor() {
    this.root = new Group();
    this.root.visible = false;
    this.#texture.colorSpace = SRGBColorSpace;
    this.#surface.position.set(0, 0, -AWAY_M);
    this.#body.add(this.#surface, this.#edges);
    this.root.add(this.#body);
    this.root.userData.moves = true;
  }

  /** A picture (an image or a video), with half the height of what it shows at 1 m (m), and width by height. */
  show(picture, half, aspect) {
    if (this.#texture.image !== picture) {
      this.#texture.dispose(); // another size needs another place on the graphics card
      this.#texture.image = picture;
    }
    this.#texture.needsUpdate = true;
    const shape = `${half} ${aspect}`;
    if (shape === this.#shape) return;
    this.#shape = shape;
    const [w, h] = [half * aspect * AWAY_M, half * AWAY_M];
    this.#surface.scale.set(2 * w, 2 * h, 1);
    const corners = [[-w, -h], [w, -h], [w, h], [-w, h]].map(([x, y]) => [x, y, -AWAY_M]);
    const points = corners.flatMap((corner, i) => [[0, 0, 0], corner, corner, corners[(i + 1) % 4]]);
    this.#edges.geometry.setAttribute("position", new BufferAttribute(new Float32Array(points.flat()), 3));
  }

  /** Where the one who sees is drawn, {position, quat_xyzw}, or null; `up`: which axis of its body points up. */
  place(at, up) {
    this.root.visible = at !== null && this.#shape !== null;
    if (at === null) return;
    this.root.position.set(...at.position);
    this.root.quaternion.set(...at.quat_xyzw);
    this.#body.quaternion.set(...(up === "z" ? Z_UP_FROM_Y_UP : [0, 0, 0, 1]));
  }

  dispose() {
    this.#texture.dispose();
    this.#surface.material.dispose();
    this.#edges.geometry.dispose();
    this.#edges.material.dispose();
  }
}
