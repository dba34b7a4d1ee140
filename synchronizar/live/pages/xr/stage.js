/** What is drawn: the device's own frame (y up, as WebXR has it), and in it the common one (z up) where it is shown. */

import {
  DirectionalLight,
  Frustum,
  Group,
  HemisphereLight,
  Matrix4,
  PerspectiveCamera,
  Scene,
  Sphere,
  Vector3,
  WebGLRenderer,
} from "../vendor/three/three.module.min.js";

import { deviceFromCommon } from "../axes.js";

const REACH_M = 0.4;

export class Stage {
  #frustum = new Frustum();
  #matrix = new Matrix4();

  constructor() {
    this.renderer = new WebGLRenderer({ antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    this.renderer.setSize(innerWidth, innerHeight, false);
    this.renderer.xr.enabled = true;
    this.renderer.xr.setReferenceSpaceType("local");
    this.camera = new PerspectiveCamera(60, innerWidth / innerHeight, 0.02, 200);
    this.scene = new Scene();
    this.scene.add(new HemisphereLight(0xffffff, 0x667788, 2.2));
    const sun = new DirectionalLight(0xffffff, 1.5);
    sun.position.set(1, 3, 2);
    this.scene.add(sun);
    this.common = new Group();
    this.common.matrixAutoUpdate = false;
    this.common.visible = false;
    this.scene.add(this.common);
  }

  /** Put the common frame where `placing` says that it is. */
  place(placing) {
    this.common.visible = placing !== null;
    if (placing === null) return;
    this.common.matrix.fromArray(deviceFromCommon(placing, "y"));
    this.common.matrixWorldNeedsUpdate = true;
  }

  /** What of the common frame is on the screen: "things" that stand, or else "people", or "nothing". */
  get inView() {
    const camera = this.renderer.xr.isPresenting ? this.renderer.xr.getCamera() : this.camera;
    this.#frustum.setFromProjectionMatrix(this.#matrix.multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse));
    const at = new Vector3();
    const seen = this.common.children.filter(
      (thing) => thing.visible && this.#frustum.intersectsSphere(new Sphere(thing.getWorldPosition(at), REACH_M)),
    );
    if (!seen.length) return "nothing";
    return seen.every((thing) => thing.userData.moves) ? "people" : "things";
  }

  draw() {
    this.renderer.render(this.scene, this.camera);
  }
}
