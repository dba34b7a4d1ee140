/** What a device sees, as a picture: its camera's where the page may have that, else what is drawn from where it is. */

import {
  Color,
  Mesh,
  OrthographicCamera,
  PerspectiveCamera,
  PlaneGeometry,
  Scene,
  ShaderMaterial,
  WebGLRenderTarget,
} from "../vendor/three/three.module.min.js";

const [WIDTH, HEIGHT] = [320, 240];
/** deg, from bottom to top, of a drawn one. */
const FIELD = 50;
const GROUND = new Color(0x20262c);
/** What is drawn is linear, pictures are not. */
const SRGB = Uint8Array.from({ length: 256 }, (_, n) => {
  const v = n / 255;
  return Math.round(255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055));
});

export class Picture {
  #stage;
  #target = new WebGLRenderTarget(WIDTH, HEIGHT);
  #bytes = new Uint8Array(4 * WIDTH * HEIGHT);
  #eye = new PerspectiveCamera(FIELD, WIDTH / HEIGHT, 0.02, 100);
  #flat = new OrthographicCamera(-1, 1, 1, -1, 0, 1);
  #sheet = null;

  /** `stage`: what is drawn on the phone's page. */
  constructor(stage) {
    this.#stage = stage;
    this.canvas = Object.assign(document.createElement("canvas"), { width: WIDTH, height: HEIGHT });
  }

  /** Takes one, from within a frame: on `canvas`. Returns half the height (m) of what it shows at 1 m. */
  take() {
    const { renderer, camera } = this.#stage;
    const eye = renderer.xr.isPresenting ? renderer.xr.getCamera().cameras[0] ?? renderer.xr.getCamera() : camera;
    const seen = renderer.xr.isPresenting ? renderer.xr.getCameraTexture?.(eye) : null;
    const half = seen ? this.#ofCamera(seen, eye) : this.#drawn(eye);
    renderer.readRenderTargetPixels(this.#target, 0, 0, WIDTH, HEIGHT, this.#bytes);
    this.#put(seen !== null && seen !== undefined);
    return half;
  }

  #ofCamera(texture, { projectionMatrix: { elements } }) {
    this.#sheet ??= sheet();
    this.#sheet.children[0].material.uniforms.seen.value = texture;
    this.#render(this.#sheet, this.#flat);
    return 1 / elements[5];
  }

  #drawn(eye) {
    const { scene } = this.#stage;
    eye.matrixWorld.decompose(this.#eye.position, this.#eye.quaternion, this.#eye.scale);
    const before = scene.background;
    scene.background = GROUND;
    this.#render(scene, this.#eye);
    scene.background = before;
    return Math.tan((FIELD * Math.PI) / 360);
  }

  #render(scene, camera) {
    const { renderer } = this.#stage;
    const [target, xr] = [renderer.getRenderTarget(), renderer.xr.enabled];
    renderer.xr.enabled = false;
    renderer.setRenderTarget(this.#target);
    renderer.render(scene, camera);
    renderer.setRenderTarget(target);
    renderer.xr.enabled = xr;
  }

  /** Rows come from the bottom up. */
  #put(asItIs) {
    const paint = this.canvas.getContext("2d");
    const image = paint.createImageData(WIDTH, HEIGHT);
    for (let y = 0; y < HEIGHT; y++) {
      let from = 4 * WIDTH * (HEIGHT - 1 - y);
      for (let to = 4 * WIDTH * y; to < 4 * WIDTH * (y + 1); to += 4, from += 4) {
        for (let c = 0; c < 3; c++) image.data[to + c] = asItIs ? this.#bytes[from + c] : SRGB[this.#bytes[from + c]];
        image.data[to + 3] = 255;
      }
    }
    paint.putImageData(image, 0, 0);
  }

  dispose() {
    this.#target.dispose();
  }
}

function sheet() {
  const material = new ShaderMaterial({
    uniforms: { seen: { value: null } },
    vertexShader: "varying vec2 at; void main() { at = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }",
    fragmentShader: "uniform sampler2D seen; varying vec2 at; void main() { gl_FragColor = texture2D(seen, at); }",
    depthTest: false,
  });
  const scene = new Scene();
  scene.add(new Mesh(new PlaneGeometry(2, 2), material));
  return scene;
}
