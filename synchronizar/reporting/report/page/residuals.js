// The residual of each range over time.

import { choice, choose, isChosen, onChoice } from "./choice.js";
import { cleared, element, moveCursor, plain, pointIn, ticks, timeAxis, writing } from "./svg.js";
import { hideTip, showTip } from "./tip.js";
import { UNUSABLE, USED, classOf, end, ranges, users, values } from "./values.js";
import { rangeWords } from "./words.js";

const residuals = document.getElementById("residuals");
const HEIGHT = 240;
const BOTTOM = HEIGHT - 22;
const LEFT = 46;
// Share of the residuals that stands at either edge, further out than the axis goes, at most.
const BEYOND = 0.01;
const LEAST_SIGMAS = 4;
let [right, low, high, points] = [900, -1, 1, []];

const instantX = (t) => LEFT + ((right - LEFT) * t) / end;
const offY = (off) => BOTTOM - 4 - ((Math.min(Math.max(off, low), high) - low) / (high - low)) * (BOTTOM - 8);

export function startResiduals() {
  drawResiduals();
  onChoice((changed) => {
    if (["user", "pair", "rejected"].some((of) => changed.has(of))) drawResiduals();
    else showMoment();
  });
  residuals.addEventListener("pointermove", (event) => {
    const point = nearestPoint(event);
    if (point) showTip(rangeWords(point.row), event.clientX, event.clientY);
    else hideTip();
  });
  residuals.addEventListener("pointerleave", hideTip);
  residuals.addEventListener("click", (event) => {
    const point = nearestPoint(event);
    const [x] = pointIn(residuals, event);
    choose({ t: point ? ranges.t[point.row] : ((x - LEFT) / (right - LEFT)) * end });
  });
}

function whose() {
  if (choice.pair) return choice.pair.map((index) => users[index].name).join(" – ");
  return choice.user === null ? "all pairs" : users[choice.user].name;
}

export function drawResiduals() {
  right = cleared(residuals, HEIGHT) - 8;
  document.getElementById("residuals-title").textContent = `Measured minus predicted over time (m): ${whose()}`;
  const rows = [];
  for (let n = 0; n < ranges.count; n += 1) {
    if (ranges.verdict[n] === UNUSABLE || !isChosen(ranges.a[n], ranges.b[n])) continue;
    if (choice.rejected || ranges.verdict[n] === USED) rows.push(n);
  }
  const sorted = rows.map((n) => ranges.residual[n]).sort((a, b) => a - b);
  low = Math.min(-LEAST_SIGMAS * values.sigma, sorted[Math.floor(BEYOND * sorted.length)] ?? 0);
  high = Math.max(LEAST_SIGMAS * values.sigma, sorted[Math.ceil((1 - BEYOND) * sorted.length) - 1] ?? 0);
  timeAxis(residuals, instantX, end, 0, BOTTOM, right / 110);
  for (const off of ticks(low, high, 6)) {
    element("path", { class: "grid", d: `M${LEFT} ${offY(off)}H${right}` }, residuals);
    writing(residuals, plain(off), { x: LEFT - 6, y: offY(off) + 4, "text-anchor": "end" });
  }
  points = rows.map((row) => ({ row, x: instantX(ranges.t[row]), y: offY(ranges.residual[row]) }));
  const d = Array.from({ length: 14 }, () => "");
  for (const { row, x, y } of points) {
    const rejected = ranges.verdict[row] !== USED;
    d[classOf(ranges.residual[row]) + (rejected ? 7 : 0)] += rejected
      ? `M${x.toFixed(1)} ${(y - 2.5).toFixed(1)}v5`
      : `M${x.toFixed(1)} ${y.toFixed(1)}h0`;
  }
  d.forEach((path, n) => {
    if (!path) return;
    const drawn = element("path", { class: `dot${n > 6 ? " off" : ""}`, d: path }, residuals);
    drawn.style.stroke = `var(--r${n % 7})`;
  });
  showMoment();
}

function showMoment() {
  moveCursor(residuals, instantX(choice.t), BOTTOM);
}

function nearestPoint(event) {
  const [x, y] = pointIn(residuals, event);
  let [nearest, least] = [null, 9];
  for (const point of points) {
    const off = Math.hypot(point.x - x, point.y - y);
    if (off < least) [nearest, least] = [point, off];
  }
  return nearest;
}
