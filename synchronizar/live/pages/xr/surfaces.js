/**
 * Surfaces that a device's own SLAM sees, in its own frame (y up): meshes where it makes any, else depth. Each frame is
 * read seldom: rooms stand still.
 */

const EVERY_S = 0.5;
/** Points across a depth image, each way. */
const POINTS = 24;
/** m: nearer is a hand, farther is too coarse. */
const [NEAREST_M, FARTHEST_M] = [0.4, 5];

export class Scanner {
  #read = -Infinity;
  #meshes = new WeakMap();
  /** Hands surfaces of `frame` to `point(p)` and `triangle(a, b, c)`; `time` in ms. */
  scan(frame, space, time, point, triangle) {
    if (time - this.#read < 1000 * EVERY_S) return;
    this.#read = time;
    if (frame.detectedMeshes?.size) this.#scanMeshes(frame, space, triangle);
    else if (frame.session.enabledFeatures?.includes("depth-sensing")) this.#scanDepth(frame, space, point);
  }

  #scanMeshes(frame, space, triangle) {
    for (const mesh of frame.detectedMeshes) {
      // Twice, since a surface counts that was seen again.
      const [changed, times] = this.#meshes.get(mesh) ?? [null, 0];
      const seen = changed === mesh.lastChangedTime ? times : 0;
      const pose = seen < 4 ? frame.getPose(mesh.meshSpace, space) : null;
      if (!pose) continue;
      this.#meshes.set(mesh, [mesh.lastChangedTime, seen + 1]);
      const { matrix } = pose.transform;
      const corner = (n) => moved(matrix, mesh.vertices.slice(3 * n, 3 * n + 3));
      for (let n = 0; n < mesh.indices.length; n += 3) triangle(...[0, 1, 2].map((k) => corner(mesh.indices[n + k])));
    }
  }

  #scanDepth(frame, space, point) {
    const viewer = frame.getViewerPose(space);
    const view = viewer?.views[0];
    const depth = view && frame.getDepthInformation(view);
    if (!depth) return;
    const back = inverse(view.projectionMatrix);
    for (let i = 0; i < POINTS; i++) {
      for (let j = 0; j < POINTS; j++) {
        const [u, v] = [(i + 0.5) / POINTS, (j + 0.5) / POINTS];
        const d = depth.getDepthInMeters(u, v);
        if (!(d > NEAREST_M && d < FARTHEST_M)) continue;
        // Depth is along the view's -z; u to the right, v down.
        const [x, y] = back(2 * u - 1, 1 - 2 * v);
        point(moved(view.transform.matrix, [x * d, y * d, -d]));
      }
    }
  }
}

/** x and y (m) at 1 m in front of a view, of a place on its picture from -1 to 1. */
function inverse(p) {
  return (x, y) => [(x + p[8]) / p[0], (y + p[9]) / p[5]];
}

function moved(m, [x, y, z]) {
  return [0, 1, 2].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]);
}
