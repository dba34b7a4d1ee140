// Every pair: the RMS of its used residuals above the diagonal, the share of rejected ranges below it.

import { choice, choose, onChoice, togglePair } from "./choice.js";
import { cleared, colourOf, element, pointIn, writing } from "./svg.js";
import { hideTip, showTipIn } from "./tip.js";
import { pairKey, pairs, users, values } from "./values.js";
import { number, pairWords } from "./words.js";

const matrix = document.getElementById("pairs");
const RMS_SIGMAS = [0.8, 1.2, 2, 3];
const SHARES = [0.05, 0.15, 0.3, 0.6];
const longest = Math.max(...users.map((user) => user.name.length));
let [side, edge] = [20, 90];
let at = [0, Math.min(1, users.length - 1)];

const levelOf = (x, steps) => steps.filter((step) => x >= step).length;
export const shareOf = (pair) => pair.rejected / (pair.used + pair.rejected || 1);

export function startPairs() {
  drawPairs();
  drawPairLegend();
  onChoice((changed) => (changed.has("pair") || changed.has("user")) && drawPairs());
  matrix.addEventListener("pointermove", (event) => {
    const cell = cellAt(event);
    if (cell) tellPair(cell);
    else hideTip();
  });
  matrix.addEventListener("pointerleave", hideTip);
  matrix.addEventListener("blur", hideTip);
  matrix.addEventListener("focus", () => tellPair(at));
  matrix.addEventListener("click", (event) => {
    const cell = cellAt(event);
    if (cell && cell[0] !== cell[1]) togglePair(...cell);
  });
  matrix.addEventListener("keydown", onPairKey);
}

export function drawPairs() {
  edge = Math.min(7.4 * longest + 12, 110);
  const wide = cleared(matrix, 100);
  side = Math.min((wide - edge - 4) / users.length, 44);
  matrix.setAttribute("viewBox", `0 0 ${wide} ${edge + side * users.length + 4}`);
  for (const user of users) {
    const middle = edge + side * (user.index + 0.5);
    const name = user.name.length > 14 ? `${user.name.slice(0, 13)}…` : user.name;
    const chosen = choice.user === user.index || choice.pair?.includes(user.index);
    const style = chosen ? { class: "name" } : {};
    if (side > 9) {
      writing(matrix, name, { ...style, x: edge - 6, y: middle + 4, "text-anchor": "end" });
      matrix.lastChild.style.fill = colourOf(user);
      writing(matrix, name, { ...style, transform: `translate(${middle + 4} ${edge - 6}) rotate(-90)` });
      matrix.lastChild.style.fill = colourOf(user);
    }
    for (const other of users) if (other !== user) drawCell(user.index, other.index);
  }
  drawNow();
}

function drawCell(row, column) {
  const pair = pairs.get(pairKey(row, column));
  const [x, y] = [edge + side * column, edge + side * row];
  const cell = element("rect", { class: "cell", x, y, width: side, height: side }, matrix);
  const rms = column > row;
  const value = pair && (rms ? pair.rms : shareOf(pair));
  if (!pair) cell.style.fill = "none";
  else if (value === null) cell.style.fill = "var(--r6)";
  else cell.style.fill = `var(--m${rms ? levelOf(value / values.sigma, RMS_SIGMAS) : levelOf(value, SHARES)})`;
  if (pair && value !== null && side > 34) {
    const level = rms ? levelOf(value / values.sigma, RMS_SIGMAS) : levelOf(value, SHARES);
    const text = rms ? number(value, 2) : `${number(100 * value, 0)} %`;
    writing(matrix, text, { x: x + side / 2, y: y + side / 2 + 4, "text-anchor": "middle" });
    matrix.lastChild.style.fill = level > 2 ? "var(--ground)" : "var(--ink)";
  }
}

function drawNow() {
  matrix.querySelector(".now")?.remove();
  const [row, column] = choice.pair ?? at;
  if (!choice.pair && document.activeElement !== matrix) return;
  const place = { x: edge + side * column, y: edge + side * row, width: side, height: side };
  element("rect", { class: "cell now", fill: "none", ...place }, matrix);
}

function drawPairLegend() {
  const legend = document.getElementById("pairs-legend");
  const metres = RMS_SIGMAS.map((times) => number(times * values.sigma, 2));
  ["0", ...metres].forEach((from, level) => {
    const share = level ? `${100 * SHARES[level - 1]} %` : "0 %";
    entry(legend, `var(--m${level})`, level ? `from ${from} m, from ${share}` : "less");
  });
  entry(legend, "var(--r6)", "none was used");
}

function entry(legend, colour, text) {
  const item = document.createElement("span");
  const sample = element("svg", { viewBox: "0 0 26 14" });
  element("rect", { width: 26, height: 14 }, sample).style.fill = colour;
  item.append(sample, text);
  legend.append(item);
}

function cellAt(event) {
  const [x, y] = pointIn(matrix, event);
  const [row, column] = [Math.floor((y - edge) / side), Math.floor((x - edge) / side)];
  const inside = (n) => n >= 0 && n < users.length;
  return inside(row) && inside(column) && row !== column ? [row, column] : null;
}

function tellPair(cell) {
  at = cell;
  drawNow();
  if (cell[0] === cell[1]) hideTip();
  else showTipIn(matrix, pairWords(...cell), edge + side * (cell[1] + 0.5), edge + side * (cell[0] + 0.5));
}

const STEPS = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] };

function onPairKey(event) {
  if (event.key in STEPS) {
    const [down, over] = STEPS[event.key];
    const inside = (n) => Math.min(Math.max(n, 0), users.length - 1);
    let next = [inside(at[0] + down), inside(at[1] + over)];
    if (next[0] === next[1]) next = [inside(next[0] + down), inside(next[1] + over)];
    if (next[0] !== next[1]) tellPair(next);
  } else if (event.key === "Enter" || event.key === " ") {
    togglePair(...at);
  } else if (event.key === "Escape") {
    choose({ pair: null, user: null });
    hideTip();
  } else {
    return;
  }
  event.preventDefault();
}
