/** The room from above, on a canvas: everybody's track, heading and ellipse, and the distances between them. */

import { OLD_S, TRAIL_S } from "../room/model.js";
import { Camera } from "./camera.js";
import { colourOf, residualColour } from "./colours.js";

/** s for which a distance is drawn after it came. */
const RANGE_S = 1.5;
/** Half-axes of the ellipses in sigmas: 95 % in a plane lie within. */
const SIGMAS = 2.45;
/** m: a wider ellipse says no more than that nothing is known. */
const WIDEST_M = 8;
/** In so many steps a track fades. */
const PIECES = 16;
/** Of a device, and how far it is seen to look, in letters' heights. */
const DOT = 0.57;
const SIGHT = 2.4;

export class TopView {
  #canvas;
  #model;
  #camera = new Camera();
  #at = null;
  #dot = 8;
  #drag = null;

  /** What draws above all else, with each frame: (paint, camera). */
  above = null;

  constructor(canvas, model) {
    this.#canvas = canvas;
    this.#model = model;
    new ResizeObserver(() => this.#resize()).observe(canvas);
    this.#resize();
    this.#listen();
    requestAnimationFrame((now) => this.#frame(now));
  }

  /** Follow everybody again. */
  fit() {
    this.#camera.fitting = true;
  }

  zoom(factor) {
    this.#camera.zoom(factor);
  }

  #resize() {
    const { clientWidth, clientHeight } = this.#canvas;
    const ratio = Math.min(devicePixelRatio || 1, 2);
    this.#canvas.width = Math.max(1, Math.round(clientWidth * ratio));
    this.#canvas.height = Math.max(1, Math.round(clientHeight * ratio));
    this.#camera.resize(clientWidth, clientHeight);
  }

  #listen() {
    const canvas = this.#canvas;
    canvas.addEventListener("pointerdown", (event) => {
      this.#drag = [event.clientX, event.clientY];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!this.#drag) return;
      this.#camera.pan(event.clientX - this.#drag[0], event.clientY - this.#drag[1]);
      this.#drag = [event.clientX, event.clientY];
    });
    for (const type of ["pointerup", "pointercancel"]) canvas.addEventListener(type, () => (this.#drag = null));
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const box = canvas.getBoundingClientRect();
        this.#camera.zoom(Math.exp(-event.deltaY / 500), [event.clientX - box.left, event.clientY - box.top]);
      },
      { passive: false },
    );
    canvas.addEventListener("keydown", (event) => {
      const moves = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
      if (moves[event.key]) this.#camera.pan(...moves[event.key]);
      else if (event.key === "+" || event.key === "=") this.zoom(1.25);
      else if (event.key === "-") this.zoom(0.8);
      else if (event.key === "0" || event.key === "f") this.fit();
      else return;
      event.preventDefault();
    });
  }

  #frame(now) {
    const dt = this.#at === null ? 0 : Math.min(0.2, (now - this.#at) / 1000);
    this.#at = now;
    const users = this.#model.present;
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.#camera.follow(seen(users), dt, still);
    this.#draw(users);
    requestAnimationFrame((later) => this.#frame(later));
  }

  #draw(users) {
    const canvas = this.#canvas;
    const paint = canvas.getContext("2d");
    const style = getComputedStyle(canvas);
    const colours = {
      grid: style.getPropertyValue("--grid"),
      axis: style.getPropertyValue("--axis"),
      ink: style.getPropertyValue("--ink"),
      ground: style.getPropertyValue("--ground"),
    };
    const ratio = canvas.width / this.#camera.width;
    paint.setTransform(ratio, 0, 0, ratio, 0, 0);
    paint.clearRect(0, 0, this.#camera.width, this.#camera.height);
    paint.font = style.font;
    this.#dot = DOT * parseFloat(style.fontSize);
    paint.lineJoin = "round";
    this.#grid(paint, colours);
    for (const user of users) this.#trail(paint, user);
    for (const user of users) this.#ellipse(paint, user);
    this.#ranges(paint, colours);
    for (const user of users) this.#device(paint, user, colours);
    this.#names(paint, users, colours);
    this.above?.(paint, this.#camera);
    this.#scaleBar(paint, colours);
  }

  #grid(paint, colours) {
    const { width, height, gridStep: step } = this.#camera;
    const [left, top] = this.#camera.toRoom([0, 0]);
    const [right, low] = this.#camera.toRoom([width, height]);
    for (const [from, to, line] of [
      [left, right, (v) => [[v, low], [v, top]]],
      [low, top, (v) => [[left, v], [right, v]]],
    ]) {
      for (let k = Math.ceil(from / step); k * step <= to; k++) {
        const [[x0, y0], [x1, y1]] = line(k * step).map((p) => this.#camera.toScreen(p));
        paint.strokeStyle = k === 0 ? colours.axis : colours.grid;
        paint.lineWidth = 1;
        paint.beginPath();
        paint.moveTo(x0, y0);
        paint.lineTo(x1, y1);
        paint.stroke();
      }
    }
  }

  #trail(paint, user) {
    paint.strokeStyle = colourOf(user.index);
    paint.lineWidth = 2;
    // Pieces that fade one by one must not overlap.
    paint.lineCap = "butt";
    for (const { points, share } of pieces(user.trail, this.#model.posesAt ?? 0)) {
      paint.globalAlpha = 0.08 + 0.5 * share;
      paint.beginPath();
      points.forEach(({ x, y }, i) => {
        const [px, py] = this.#camera.toScreen([x, y]);
        if (i) paint.lineTo(px, py);
        else paint.moveTo(px, py);
      });
      paint.stroke();
    }
    paint.globalAlpha = 1;
    paint.lineCap = "round";
  }

  #ellipse(paint, { index, pose, told }) {
    if (!pose?.ellipse) return;
    const { major, minor, direction } = pose.ellipse;
    const [x, y] = this.#camera.toScreen([pose.x, pose.y]);
    const [a, b] = [major, minor].map((v) => Math.max(2, Math.min(SIGMAS * v, WIDEST_M) * this.#camera.scale));
    paint.strokeStyle = paint.fillStyle = colourOf(index);
    paint.setLineDash(told?.state === "registered" ? [] : [5, 5]);
    paint.lineWidth = 1.25;
    paint.beginPath();
    paint.ellipse(x, y, a, b, -direction, 0, 2 * Math.PI);
    paint.globalAlpha = 0.12;
    paint.fill();
    paint.globalAlpha = 0.8;
    paint.stroke();
    paint.globalAlpha = 1;
    paint.setLineDash([]);
  }

  #ranges(paint, colours) {
    for (const { a, b, distance, residual, used, age } of this.#model.pairs) {
      const [from, to] = [this.#model.users.get(a)?.pose, this.#model.users.get(b)?.pose];
      if (!from || !to || age > RANGE_S) continue;
      const [x0, y0] = this.#camera.toScreen([from.x, from.y]);
      const [x1, y1] = this.#camera.toScreen([to.x, to.y]);
      paint.strokeStyle = residualColour(residual);
      paint.lineWidth = used ? 2.5 : 1.5;
      paint.setLineDash(used ? [] : [2, 6]);
      paint.globalAlpha = 0.85;
      paint.beginPath();
      paint.moveTo(x0, y0);
      paint.lineTo(x1, y1);
      paint.stroke();
      paint.setLineDash([]);
      paint.globalAlpha = 1;
      if (Math.hypot(x1 - x0, y1 - y0) > 110 && this.#model.users.size <= 8) {
        text(paint, distance.toFixed(2), (x0 + x1) / 2, (y0 + y1) / 2, colours, "center");
      }
    }
  }

  #device(paint, user, colours) {
    const { pose, index, here } = user;
    if (!pose) return;
    const [x, y] = this.#camera.toScreen([pose.x, pose.y]);
    const sure = pose.state === "registered";
    const dot = this.#dot;
    paint.globalAlpha = here && pose.age < OLD_S ? 1 : 0.45;
    paint.fillStyle = paint.strokeStyle = colourOf(index);
    if (pose.heading !== null) {
      // A wedge of what it looks at, as wide as a phone's camera.
      paint.beginPath();
      paint.moveTo(x, y);
      paint.arc(x, y, (SIGHT / DOT) * dot, -pose.heading - 0.5, -pose.heading + 0.5);
      paint.closePath();
      paint.save();
      paint.globalAlpha *= 0.3;
      paint.fill();
      paint.restore();
    }
    paint.beginPath();
    if (user.static) paint.rect(x - dot * 0.8, y - dot * 0.8, 1.6 * dot, 1.6 * dot);
    else paint.arc(x, y, dot, 0, 2 * Math.PI);
    paint.lineWidth = 2.5;
    if (sure) {
      paint.fill();
      paint.strokeStyle = colours.ground;
      paint.stroke();
    } else {
      paint.fillStyle = colours.ground;
      paint.fill();
      paint.setLineDash([3, 3]);
      paint.stroke();
      paint.setLineDash([]);
    }
    paint.globalAlpha = 1;
  }

  /** Each name beside its device, on the first side where nobody else and no other name is. */
  #names(paint, users, colours) {
    const shown = users.filter(({ pose }) => pose);
    const dot = this.#dot;
    const line = 2 * dot;
    const taken = shown.map(({ pose }) => {
      const [x, y] = this.#camera.toScreen([pose.x, pose.y]);
      return [x - dot, y - dot, x + dot, y + dot];
    });
    paint.save();
    paint.font = `600 ${paint.font}`;
    for (const { pose, name, here } of shown) {
      const [x, y] = this.#camera.toScreen([pose.x, pose.y]);
      const words = pose.state === "registered" ? name : `${name} ?`;
      const width = paint.measureText(words).width;
      const boxes = [
        [x + dot + 4, y - dot - 0.85 * line],
        [x - dot - 4 - width, y - dot - 0.85 * line],
        [x + dot + 4, y + dot - 2],
        [x - dot - 4 - width, y + dot - 2],
      ].map(([left, top]) => [left, top, left + width, top + line]);
      const box = boxes.find((one) => !taken.some((other) => overlap(one, other))) ?? boxes[0];
      taken.push(box);
      paint.globalAlpha = here && pose.age < OLD_S ? 1 : 0.6;
      text(paint, words, box[0], box[1] + dot, colours, "left");
    }
    paint.restore();
  }

  #scaleBar(paint, colours) {
    const step = this.#camera.gridStep;
    const [x, y] = [16, this.#camera.height - 16];
    paint.strokeStyle = colours.ink;
    paint.lineWidth = 2;
    paint.beginPath();
    paint.moveTo(x, y - 5);
    paint.lineTo(x, y);
    paint.lineTo(x + step * this.#camera.scale, y);
    paint.lineTo(x + step * this.#camera.scale, y - 5);
    paint.stroke();
    text(paint, `${step} m`, x + (step * this.#camera.scale) / 2, y - 12, colours, "center");
  }
}

/** A track in pieces of about the same age, each drawn at once: {points, share}, share 1 where it is new, 0 where old. */
export function pieces(trail, now) {
  const made = [];
  let last = null;
  trail.forEach((point, i) => {
    if (point === null) last = null;
    const before = trail[i - 1];
    if (!point || !before) return;
    const age = Math.max(0, Math.floor((PIECES * (now - point.t)) / TRAIL_S));
    if (last?.age !== age) made.push((last = { age, points: [before], share: Math.max(0, 1 - age / PIECES) }));
    last.points.push(point);
  });
  return made;
}

/** Places that should be on the canvas: where everybody is and was of late. */
function seen(users) {
  return users.flatMap(({ pose, trail }) => [
    ...(pose ? [[pose.x, pose.y]] : []),
    ...trail.filter((point, i) => point && i % 8 === 0).map(({ x, y }) => [x, y]),
  ]);
}

function overlap([left, top, right, low], [l, t, r, b]) {
  return left < r && l < right && top < b && t < low;
}

function text(paint, words, x, y, colours, align) {
  paint.textAlign = align;
  paint.textBaseline = "middle";
  paint.strokeStyle = colours.ground;
  paint.lineWidth = 4;
  paint.strokeText(words, x, y);
  paint.fillStyle = colours.ink;
  paint.fillText(words, x, y);
}

