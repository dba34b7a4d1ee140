// The map: who was where at the moment that is looked at, and the ranges just before it, coloured by residual.

import { choice, choose, isChosen, isFaded, onChoice, togglePair, toggleUser } from "./choice.js";
import { cleared, colourOf, element, lineOf, plain, pointIn, ticks, writing } from "./svg.js";
import { hideTip, showTipIn } from "./tip.js";
import { UNUSABLE, USED, classOf, firstFrom, historyAt, jumps, placeAt, ranges, users } from "./values.js";
import { jumpWords, rangeWords, userWords } from "./words.js";

const MOST_DRAWN = 4000;
const TAIL_S = 4;
// Classes of residuals, of used and then of rejected ranges: what is further off is drawn above the rest.
const BY_SIZE = [3, 10, 2, 4, 9, 11, 1, 5, 8, 12, 0, 6, 7, 13];
const CHI_95 = Math.sqrt(-2 * Math.log(0.05));
const map = document.getElementById("map");
const view = { x: 0, y: 0, scale: 50, width: 900, height: 500 };
const far = (column) => column.reduce((most, x) => Math.max(most, x), -Infinity);
const near = (column) => column.reduce((least, x) => Math.min(least, x), Infinity);
let layers = {};
let [markers, lines, marks] = [[], [], []];
let picked = null;

const toX = (x) => view.width / 2 + (x - view.x) * view.scale;
const toY = (y) => view.height / 2 - (y - view.y) * view.scale;

export function startMap() {
  fitMap();
  onChoice(drawMap);
  map.addEventListener("pointermove", onHover);
  map.addEventListener("pointerleave", () => letGo());
  map.addEventListener("click", onClick);
  map.addEventListener("keydown", onKey);
  map.addEventListener("blur", () => letGo());
  map.addEventListener("wheel", onWheel, { passive: false });
  map.addEventListener("pointerdown", onDrag);
  document.getElementById("nearer").addEventListener("click", () => zoom(1.4));
  document.getElementById("further").addEventListener("click", () => zoom(1 / 1.4));
  document.getElementById("fit").addEventListener("click", () => {
    fitMap();
    drawMap();
  });
}

// All tracks, and what else the ranges allow.
function fitMap() {
  const columns = users.filter((user) => user.track).map((user) => [user.track.x, user.track.y]);
  for (const user of users) {
    for (const walk of user.others) columns.push([walk.map((place) => place[0]), walk.map((place) => place[1])]);
  }
  if (!columns.length) columns.push([[-1, 1], [-1, 1]]);
  const [west, east] = [near(columns.map(([x]) => near(x))), far(columns.map(([x]) => far(x)))];
  const [south, north] = [near(columns.map(([, y]) => near(y))), far(columns.map(([, y]) => far(y)))];
  measure();
  [view.x, view.y] = [(west + east) / 2, (south + north) / 2];
  const [wide, high] = [Math.max(east - west, 0.5), Math.max(north - south, 0.5)];
  view.scale = 0.88 * Math.min(view.width / wide, view.height / high);
}

function measure() {
  const width = Math.max(240, map.clientWidth);
  const height = Math.round(Math.min(Math.max(0.62 * width, 320), 680));
  view.scale *= width / view.width;
  [view.width, view.height] = [width, height];
}

export function resizeMap() {
  measure();
  drawMap();
}

function drawMap() {
  cleared(map, view.height);
  map.classList.toggle("of-one", choice.user !== null || choice.pair !== null);
  layers = {};
  for (const name of ["grid", "whole", "ranges", "tails", "marks", "names"]) layers[name] = element("g", {}, map);
  drawGrid();
  if (choice.trails) drawWhole();
  drawRanges();
  drawJumps();
  drawUsers();
  drawPicked();
}

function drawGrid() {
  const [wide, high] = [view.width / view.scale / 2, view.height / view.scale / 2];
  const step = ticks(0, (2 * wide * 90) / view.width, 1)[1] ?? 1;
  for (let x = Math.ceil((view.x - wide) / step) * step; x < view.x + wide; x += step) {
    element("path", { class: "grid", d: `M${toX(x)} 0V${view.height}` }, layers.grid);
    writing(layers.grid, plain(x), { x: toX(x) + 3, y: view.height - 5 });
  }
  for (let y = Math.ceil((view.y - high) / step) * step; y < view.y + high; y += step) {
    element("path", { class: "grid", d: `M0 ${toY(y)}H${view.width}` }, layers.grid);
    if (toY(y) > 16 && toY(y) < view.height - 24) writing(layers.grid, `${plain(y)} m`, { x: 4, y: toY(y) - 4 });
  }
}

function pathOf(track, from, to, gap) {
  let [d, last] = ["", -Infinity];
  for (let n = from; n < to; n += 1) {
    const point = `${toX(track.x[n]).toFixed(1)} ${toY(track.y[n]).toFixed(1)}`;
    d += `${track.t[n] - last > gap ? "M" : "L"}${point}`;
    last = track.t[n];
  }
  return d;
}

function drawWhole() {
  for (const user of users.filter((one) => one.track && !one.static)) {
    const chosen = isFaded(user.index) || (choice.user === null && choice.pair === null) ? "" : " chosen";
    const d = pathOf(user.track, 0, user.track.t.length, user.gap);
    lineOf(user, { class: `line whole${chosen}`, d }, layers.whole);
    for (const walk of user.others) {
      const other = walk.map(([x, y], n) => `${n ? "L" : "M"}${toX(x).toFixed(1)} ${toY(y).toFixed(1)}`).join("");
      lineOf(user, { class: `line other${isFaded(user.index) ? " faded" : ""}`, d: other }, layers.whole);
    }
  }
}

function drawRanges() {
  const [from, to] = [firstFrom(ranges.t, choice.t - choice.span), firstFrom(ranges.t, choice.t + 1e-9)];
  const every = Math.max(1, Math.ceil((to - from) / MOST_DRAWN));
  const d = Array.from({ length: 14 }, () => "");
  lines = [];
  for (let row = from; row < to; row += every) {
    const rejected = ranges.verdict[row] !== USED;
    if (ranges.verdict[row] === UNUSABLE || (rejected && !choice.rejected)) continue;
    const [a, b] = [ranges.a[row], ranges.b[row]];
    if (!isChosen(a, b)) continue;
    const [begin, finish] = [placeAt(users[a], ranges.t[row]), placeAt(users[b], ranges.t[row])];
    if (!begin || !finish) continue;
    const line = { row, x0: toX(begin.x), y0: toY(begin.y), x1: toX(finish.x), y1: toY(finish.y) };
    lines.push(line);
    d[classOf(ranges.residual[row]) + (rejected ? 7 : 0)] +=
      `M${line.x0.toFixed(1)} ${line.y0.toFixed(1)}L${line.x1.toFixed(1)} ${line.y1.toFixed(1)}`;
  }
  BY_SIZE.forEach((n) => {
    if (!d[n]) return;
    const drawn = element("path", { d: d[n], class: `range${n > 6 ? " off" : ""}` }, layers.ranges);
    drawn.style.stroke = `var(--r${n % 7})`;
    if (lines.length > 1200) drawn.style.opacity = 0.3;
  });
}

function cross(x, y, size) {
  return `M${x - size} ${y - size}L${x + size} ${y + size}M${x - size} ${y + size}L${x + size} ${y - size}`;
}

function drawJumps() {
  marks = [];
  for (const jump of jumps) {
    const shown = choice.trails || (jump.t <= choice.t && jump.t >= choice.t - TAIL_S);
    if (!jump.place || !shown || isFaded(jump.user)) continue;
    const [x, y] = [toX(jump.place[0]), toY(jump.place[1])];
    marks.push({ jump, x, y });
    element("path", { class: "jump", d: cross(x, y, 4) }, layers.marks).style.stroke = colourOf(users[jump.user]);
  }
}

function drawUsers() {
  markers = [];
  for (const user of users) {
    const place = placeAt(user, choice.t);
    if (!place) continue;
    const faded = isFaded(user.index) ? " faded" : "";
    const [x, y] = [toX(place.x), toY(place.y)];
    if (!user.static) {
      const [from, to] = [firstFrom(user.track.t, choice.t - TAIL_S), firstFrom(user.track.t, choice.t + 1e-9)];
      lineOf(user, { class: `line tail${faded}`, d: pathOf(user.track, from, to, user.gap) }, layers.tails);
    }
    if (!faded) drawEllipse(user, x, y);
    markers.push({ user, place, x, y });
    const shape = user.static
      ? element("path", { d: `M${x} ${y - 8}l7 12h-14z`, class: faded.trim() }, layers.marks)
      : element("circle", { cx: x, cy: y, r: 5.5, class: faded.trim(), stroke: "var(--ground)", "stroke-width": 1.5 }, layers.marks);
    shape.style.fill = colourOf(user);
  }
  drawNames();
}

// The 95 % region of a place: of the whole walk's end there; of a replay a circle of the longest axis as known then.
function drawEllipse(user, x, y) {
  const [longer, shorter, angle] = (user.history ? sigmaAt(user) : atItsEnd(user)) ?? [0, 0, 0];
  const [rx, ry] = [CHI_95 * longer * view.scale, CHI_95 * shorter * view.scale];
  if (!(rx > 1) || rx > view.width) return;
  const turned = `translate(${x} ${y}) rotate(${(-angle * 180) / Math.PI})`;
  const drawn = element("ellipse", { class: "ellipse", rx, ry, transform: turned }, layers.tails);
  [drawn.style.stroke, drawn.style.fill] = [colourOf(user), colourOf(user)];
}

function atItsEnd(user) {
  return user.static || choice.t >= user.track.t.at(-1) - 0.5 ? user.ellipse : null;
}

function sigmaAt(user) {
  const sigma = historyAt(user.history.sigma, choice.t);
  return Number.isFinite(sigma) ? [sigma, sigma, 0] : null;
}

// Names beside their markers, where there is room: no two of them, and no name and marker, overlap.
function drawNames() {
  const taken = markers.map(({ x, y }) => [x - 7, y - 7, x + 7, y + 7]);
  for (const { user, x, y } of markers) {
    if (isFaded(user.index)) continue;
    const width = 7.2 * user.name.length + 2;
    const spot = freeSpot(x, y, width, taken) ?? [x + 9, y - 7];
    const [left, top] = spot;
    taken.push([left, top, left + width, top + 14]);
    const [nearX, nearY] = [Math.min(Math.max(x, left), left + width), Math.min(Math.max(y, top), top + 14)];
    if (Math.hypot(nearX - x, nearY - y) > 16) {
      element("path", { class: "leader", d: `M${x} ${y}L${nearX} ${nearY}` }, layers.tails);
    }
    writing(layers.names, user.name, { class: "name", x: left, y: top + 11 });
    layers.names.lastChild.style.fill = colourOf(user);
  }
}

function freeSpot(x, y, width, taken) {
  for (const away of [9, 20, 34, 50, 70]) {
    for (const turn of [-0.5, 0.5, -2.64, 2.64, 0, Math.PI, -1.57, 1.57]) {
      const [dx, dy] = [Math.cos(turn), Math.sin(turn)];
      const left = dx > 0.3 ? x + away * dx : dx < -0.3 ? x + away * dx - width : x - width / 2;
      const top = y + away * dy - 7 + (Math.abs(dx) < 0.3 ? 5 * dy : 0);
      const free = left > 2 && top > 2 && left + width < view.width - 2 && top + 14 < view.height - 2;
      const clear = ([l, t, r, b]) => left > r || left + width < l || top > b || top + 14 < t;
      if (free && taken.every(clear)) return [left, top];
    }
  }
  return null;
}

// What is under a point: a device, a jump or a range.
function under(x, y) {
  const distance = (at) => Math.hypot(at.x - x, at.y - y);
  const nearest = (all, reach) => all.filter((at) => distance(at) < reach).sort((a, b) => distance(a) - distance(b))[0];
  const marker = nearest(markers, 10);
  if (marker) return { marker };
  const mark = nearest(marks, 9);
  if (mark) return { mark };
  let [line, least] = [null, 6];
  for (const one of lines) {
    const [dx, dy] = [one.x1 - one.x0, one.y1 - one.y0];
    const share = Math.min(Math.max(((x - one.x0) * dx + (y - one.y0) * dy) / (dx * dx + dy * dy || 1), 0), 1);
    const off = Math.hypot(one.x0 + share * dx - x, one.y0 + share * dy - y);
    if (off < least) [line, least] = [one, off];
  }
  return line && { line };
}

function pick(what, x, y) {
  picked = what;
  drawPicked();
  if (!what) hideTip();
  else if (what.marker) showTipIn(map, userWords(what.marker.user, choice.t, what.marker.place), x, y);
  else if (what.mark) showTipIn(map, jumpWords(what.mark.jump), x, y);
  else showTipIn(map, rangeWords(what.line.row), x, y);
}

function letGo() {
  picked = null;
  drawPicked();
  hideTip();
}

function drawPicked() {
  layers.picked?.remove();
  if (!picked) return;
  layers.picked = element("g", {}, map);
  const line = picked.line && lines.find((one) => one.row === picked.line.row);
  if (line) element("path", { class: "picked", d: `M${line.x0} ${line.y0}L${line.x1} ${line.y1}` }, layers.picked);
  const at = picked.marker ?? picked.mark;
  if (at) element("circle", { class: "picked", cx: at.x, cy: at.y, r: 9 }, layers.picked);
}

function onHover(event) {
  if (map.classList.contains("held")) return;
  const [x, y] = pointIn(map, event);
  pick(under(x, y), x, y);
}

function onClick(event) {
  const [x, y] = pointIn(map, event);
  const what = under(x, y);
  pick(what, x, y);
  if (what?.marker) toggleUser(what.marker.user.index);
  else if (what?.mark) choose({ t: what.mark.jump.t });
  else if (what) togglePair(ranges.a[what.line.row], ranges.b[what.line.row]);
}

function zoom(times, x = view.width / 2, y = view.height / 2) {
  const [east, north] = [(x - view.width / 2) / view.scale, (view.height / 2 - y) / view.scale];
  const before = view.scale;
  view.scale = Math.min(Math.max(view.scale * times, 0.5), 5000);
  view.x += east * (1 - before / view.scale);
  view.y += north * (1 - before / view.scale);
  drawMap();
}

function onWheel(event) {
  if (!event.ctrlKey && !event.metaKey) return;
  event.preventDefault();
  zoom(Math.exp(-0.002 * event.deltaY), ...pointIn(map, event));
}

function onDrag(event) {
  if (event.button !== 0 || event.pointerType === "touch") return;
  const [from, start] = [pointIn(map, event), { ...view }];
  const move = (moved) => {
    const [x, y] = pointIn(map, moved);
    if (Math.hypot(x - from[0], y - from[1]) < 3) return;
    map.classList.add("held");
    map.setPointerCapture(event.pointerId);
    [view.x, view.y] = [start.x - (x - from[0]) / view.scale, start.y + (y - from[1]) / view.scale];
    drawMap();
  };
  const stop = (up) => {
    map.removeEventListener("pointermove", move);
    if (map.classList.contains("held")) map.addEventListener("click", (click) => click.stopImmediatePropagation(), { capture: true, once: true });
    map.classList.remove("held");
    if (map.hasPointerCapture(up.pointerId)) map.releasePointerCapture(up.pointerId);
  };
  map.addEventListener("pointermove", move);
  map.addEventListener("pointerup", stop, { once: true });
}

function stepRange(by) {
  if (!lines.length) return;
  const at = picked?.line ? lines.findIndex((one) => one.row === picked.line.row) : -1;
  const next = at < 0 ? (by > 0 ? 0 : lines.length - 1) : (at + by + lines.length) % lines.length;
  const line = lines[next];
  pick({ line }, (line.x0 + line.x1) / 2, (line.y0 + line.y1) / 2);
}

function stepJump(by) {
  const later = by > 0 ? jumps.find((one) => one.t > choice.t + 1e-6) : jumps.findLast((one) => one.t < choice.t - 1e-6);
  if (later) goToJump(later);
}

export function goToJump(jump) {
  choose({ t: jump.t });
  const place = jump.place ?? [view.x, view.y];
  const mark = { jump, x: toX(place[0]), y: toY(place[1]) };
  pick({ mark }, mark.x, mark.y);
}

const KEYS = {
  "+": () => zoom(1.4),
  "=": () => zoom(1.4),
  "-": () => zoom(1 / 1.4),
  0: () => {
    fitMap();
    drawMap();
  },
  ArrowLeft: () => shift(-60, 0),
  ArrowRight: () => shift(60, 0),
  ArrowUp: () => shift(0, 60),
  ArrowDown: () => shift(0, -60),
  n: () => stepRange(1),
  p: () => stepRange(-1),
  j: () => stepJump(1),
  k: () => stepJump(-1),
  ",": () => choose({ t: choice.t - 0.1 }),
  ".": () => choose({ t: choice.t + 0.1 }),
  Enter: () => picked?.line && togglePair(ranges.a[picked.line.row], ranges.b[picked.line.row]),
  Escape: () => {
    letGo();
    choose({ user: null, pair: null });
  },
};

function shift(right, up) {
  view.x += right / view.scale;
  view.y += up / view.scale;
  drawMap();
}

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in KEYS)) return;
  event.preventDefault();
  KEYS[event.key]();
}
