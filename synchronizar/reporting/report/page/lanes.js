// Over time: each device's state, or when it was there and how many of its ranges were rejected; and how sure it was.

import { choice, choose, isFaded, onChoice, toggleUser } from "./choice.js";
import { cleared, colourOf, element, lineOf, moveCursor, plain, pointIn, timeAxis, writing } from "./svg.js";
import { hideTip, showTip } from "./tip.js";
import { UNUSABLE, USED, end, events, firstFrom, historyAt, jumps, ranges, stateAt, updates, users, values } from "./values.js";
import { degrees, jumpWords, number } from "./words.js";

const lanes = document.getElementById("lanes");
const sigma = document.getElementById("sigma");
export const stateColour = (state) => `var(--${values.states[state]})`;
// How high a state's bar is, as a share of its lane: colour is not all that tells states apart.
const HEIGHTS = { registered: 0.86, ambiguous: 0.58, unobservable: 0.34, disconnected: 0.1 };
const BINS = 90;
const SIGMA_HEIGHT = 220;
let [left, right, row] = [100, 900, 20];

const timeToX = (t) => left + ((right - left) * t) / end;

export function startLanes() {
  const what = values.causal
    ? "States over time"
    : "Over time: when each device was there, its share of rejected ranges, and its jumps";
  document.getElementById("lanes-title").textContent = what;
  document.getElementById("sigma-part").hidden = !values.causal;
  drawLanes();
  onChoice((changed) => {
    if (changed.has("user") || changed.has("pair")) drawLanes();
    else moveCursors();
  });
  for (const svg of [lanes, sigma]) {
    svg.addEventListener("click", (event) => {
      const [x, y] = pointIn(svg, event);
      const user = users[Math.floor(y / row)];
      if (svg === lanes && x < left - 4) user && toggleUser(user.index);
      else choose({ t: timeAt(x) });
    });
    svg.addEventListener("pointerleave", hideTip);
  }
  lanes.addEventListener("pointermove", onLanes);
  sigma.addEventListener("pointermove", onSigma);
}

const timeAt = (x) => Math.min(Math.max(((x - left) / (right - left)) * end, 0), end);

export function drawLanes() {
  row = users.length > 12 ? 18 : 24;
  const height = row * users.length + 22;
  right = cleared(lanes, height) - 8;
  left = Math.min(7.4 * Math.max(...users.map((user) => user.name.length)) + 26, 0.3 * right);
  timeAxis(lanes, timeToX, end, 0, row * users.length, right / 110);
  const shares = values.causal ? null : rejectedShares();
  for (const user of users) {
    const lane = element("g", isFaded(user.index) ? { opacity: 0.25 } : {}, lanes);
    const middle = row * (user.index + 0.5);
    lineOf(user, { class: "line", "stroke-width": 3, d: `M0 ${middle}h12` }, lane);
    const most = Math.max(3, Math.floor((left - 24) / 7.2));
    writing(lane, user.name.length > most ? `${user.name.slice(0, most - 1)}…` : user.name, { class: "name", x: 16, y: middle + 4 });
    lane.lastChild.style.fill = colourOf(user);
    if (values.causal) drawStates(lane, user, middle);
    else drawPresence(lane, user, middle, shares[user.index]);
    for (const jump of user.jumps) {
      const x = timeToX(jump.t);
      element("path", { d: `M${x - 4} ${middle - 4}l8 8m0 -8l-8 8`, stroke: "var(--ground)", "stroke-width": 5 }, lane);
      element("path", { class: "jump", d: `M${x - 4} ${middle - 4}l8 8m0 -8l-8 8`, stroke: "var(--ink)" }, lane);
    }
  }
  if (values.causal) drawSigma();
  moveCursors();
}

function moveCursors() {
  for (const svg of values.causal ? [lanes, sigma] : [lanes]) {
    moveCursor(svg, timeToX(choice.t), svg.viewBox.baseVal.height - 20);
  }
}

function drawStates(lane, user, middle) {
  const states = user.history.states;
  states.forEach(([since, state], n) => {
    const [x, until] = [timeToX(n ? since : 0), timeToX(states[n + 1]?.[0] ?? end)];
    const high = row * HEIGHTS[values.states[state]];
    const bar = element("rect", { x, y: middle - high / 2, width: Math.max(until - x, 0.5), height: high }, lane);
    bar.style.fill = stateColour(state);
  });
  const top = (share) => middle + row * (0.43 - 0.86 * share);
  let d = "";
  user.history.progress.forEach((share, n) => {
    d += `${n ? "H" : "M"}${timeToX(updates[n]).toFixed(1)}${n ? "V" : " "}${top(share).toFixed(1)}`;
  });
  element("path", { class: "progress", d }, lane);
  for (const [t] of events.filter(([, text]) => text.startsWith(`${user.name}: `))) {
    element("path", { d: `M${timeToX(t) - 3} ${middle - row / 2}h6l-3 5z`, fill: "var(--ink)" }, lane);
  }
}

// Of each device and of each of so many stretches of time: [ranges, rejected ones].
function rejectedShares() {
  const out = users.map(() => Array.from({ length: BINS }, () => [0, 0]));
  for (let n = 0; n < ranges.count; n += 1) {
    if (ranges.verdict[n] === UNUSABLE) continue;
    const bin = Math.min(Math.max(Math.floor((BINS * ranges.t[n]) / end), 0), BINS - 1);
    for (const who of [ranges.a[n], ranges.b[n]]) {
      out[who][bin][0] += 1;
      out[who][bin][1] += ranges.verdict[n] === USED ? 0 : 1;
    }
  }
  return out;
}

function drawPresence(lane, user, middle, shares) {
  const high = row * 0.86;
  const [from, to] = user.static ? [0, end] : user.track ? [user.track.t[0], user.track.t.at(-1)] : [0, 0];
  const [x, until] = [timeToX(Math.max(from, 0)), timeToX(Math.min(to, end))];
  const bar = element("rect", { x, y: middle - high / 2, width: Math.max(until - x, 0), height: high }, lane);
  [bar.style.fill, bar.style.opacity] = [stateColour(user.state), 0.45];
  let d = "";
  shares.forEach(([all, rejected], bin) => {
    if (!rejected) return;
    const tall = (high * rejected) / all;
    d += `M${timeToX((bin * end) / BINS).toFixed(1)} ${(middle + high / 2).toFixed(1)}v${(-tall).toFixed(1)}H${timeToX(((bin + 1) * end) / BINS).toFixed(1)}v${tall.toFixed(1)}z`;
  });
  element("path", { d, fill: "var(--r5)" }, lane);
}

function onLanes(event) {
  const [x, y] = pointIn(lanes, event);
  const user = users[Math.floor(y / row)];
  if (!user || x < left - 4) {
    hideTip();
    return;
  }
  const jump = jumps.find((one) => one.user === user.index && Math.abs(timeToX(one.t) - x) < 6);
  showTip(jump ? jumpWords(jump) : laneWords(user, timeAt(x)), event.clientX, event.clientY);
}

function laneWords(user, t) {
  const lines = [`${user.name} at ${number(t, 1)} s: ${values.states[stateAt(user, t)]}`];
  if (!user.history) return `${lines[0]}\n${user.reason}`;
  lines.push(`progress ${number(100 * historyAt(user.history.progress, t), 0)} %, ${sureness(user, t)}`);
  const cue = user.history.cues.findLast(([since]) => since <= t)?.[1];
  if (cue) lines.push(cue);
  return lines.concat(events.filter(([at, text]) => Math.abs(timeToX(at) - timeToX(t)) < 6 && text.startsWith(`${user.name}: `)).map(([, text]) => text)).join("\n");
}

function sureness(user, t) {
  const turned = user.static ? "" : `, ±${degrees(historyAt(user.history.yawSigma, t))}°`;
  return `1σ ±${number(historyAt(user.history.sigma, t), 2)} m${turned}`;
}

let sigmaToY = () => 0;

function drawSigma() {
  cleared(sigma, SIGMA_HEIGHT);
  const known = users.flatMap((user) => Array.from(user.history.sigma).filter((x) => x > 0));
  const [low, high] = known.length ? [Math.max(Math.min(...quantiles(known)), 1e-3), Math.max(...quantiles(known))] : [0.01, 1];
  const bottom = SIGMA_HEIGHT - 22;
  const span = Math.log(Math.max(high / low, 2));
  sigmaToY = (x) => Math.min(Math.max(bottom - ((bottom - 6) * Math.log(x / low)) / span, 2), bottom);
  timeAxis(sigma, timeToX, end, 0, bottom, right / 110);
  for (let power = -3; power < 4; power += 1) {
    for (const times of [1, 2, 5]) {
      const at = times * 10 ** power;
      if (at < low || at > high) continue;
      element("path", { class: "grid", d: `M${left} ${sigmaToY(at)}H${right}` }, sigma);
      writing(sigma, plain(at), { x: left - 6, y: sigmaToY(at) + 4, "text-anchor": "end" });
    }
  }
  for (const user of users) {
    let [d, drawing] = ["", false];
    user.history.sigma.forEach((x, n) => {
      if (x > 0) d += `${drawing ? "L" : "M"}${timeToX(updates[n]).toFixed(1)} ${sigmaToY(x).toFixed(1)}`;
      drawing = x > 0;
    });
    lineOf(user, { class: "line", "stroke-width": 1.5, opacity: isFaded(user.index) ? 0.15 : 1, d }, sigma);
  }
}

function quantiles(known) {
  const sorted = known.sort((a, b) => a - b);
  return [sorted[Math.floor(0.005 * sorted.length)], sorted[Math.min(Math.ceil(0.98 * sorted.length), sorted.length - 1)]];
}

function onSigma(event) {
  const [x, y] = pointIn(sigma, event);
  const t = timeAt(x);
  const off = (user) => Math.abs(sigmaToY(historyAt(user.history.sigma, t)) - y);
  const user = users.filter((one) => off(one) < 14).sort((a, b) => off(a) - off(b))[0];
  if (firstFrom(updates, t) === 0 || !user) hideTip();
  else showTip(`${user.name} at ${number(t, 1)} s: ${sureness(user, t)}`, event.clientX, event.clientY);
}
