/** Which part of the common frame's plane is on a canvas: fitted to everybody by itself, or moved by hand. */

const MARGIN_M = 1.5;
const SMALLEST_M = 6;
const SETTLING_S = 0.35;

export class Camera {
  constructor() {
    this.x = 0;
    this.y = 0;
    /** Pixels (of CSS) for a metre. */
    this.scale = 60;
    /** Whether it follows everybody by itself. */
    this.fitting = true;
    this.width = 1;
    this.height = 1;
    this.#settled = false;
  }

  #settled;

  resize(width, height) {
    this.width = width;
    this.height = height;
  }

  /** Goes on towards a view of all `points` [[x, y], ...], `dt` s after the last time. `still`: at once. */
  follow(points, dt, still = false) {
    if (!this.fitting) return;
    const xs = points.length ? points.map(([x]) => x) : [0];
    const ys = points.length ? points.map(([, y]) => y) : [0];
    const [left, right] = [Math.min(...xs) - MARGIN_M, Math.max(...xs) + MARGIN_M];
    const [low, high] = [Math.min(...ys) - MARGIN_M, Math.max(...ys) + MARGIN_M];
    const scale = Math.min(
      this.width / Math.max(right - left, SMALLEST_M),
      this.height / Math.max(high - low, SMALLEST_M),
    );
    const share = still || !this.#settled ? 1 : 1 - Math.exp(-dt / SETTLING_S);
    this.x += share * ((left + right) / 2 - this.x);
    this.y += share * ((low + high) / 2 - this.y);
    this.scale *= (scale / this.scale) ** share;
    this.#settled = points.length > 0;
  }

  /** Pixels of a place; y points up in the room and down on a screen. */
  toScreen([x, y]) {
    return [this.width / 2 + this.scale * (x - this.x), this.height / 2 - this.scale * (y - this.y)];
  }

  toRoom([px, py]) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  /** Moves what is seen by pixels. */
  pan(dx, dy) {
    this.fitting = false;
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
  }

  /** Larger or smaller about a pixel. */
  zoom(factor, [px, py] = [this.width / 2, this.height / 2]) {
    this.fitting = false;
    const [x, y] = this.toRoom([px, py]);
    this.scale = Math.min(1000, Math.max(2, this.scale * factor));
    this.x = x - (px - this.width / 2) / this.scale;
    this.y = y + (py - this.height / 2) / this.scale;
  }

  /** m between two lines of the grid, so that they stand at least 40 pixels apart. */
  get gridStep() {
    return [0.1, 0.5, 1, 2, 5, 10, 20, 50, 100].find((step) => step * this.scale >= 40) ?? 200;
  }
}
