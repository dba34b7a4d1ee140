// Starts the page: the head, the controls of time, the legends, and every drawing.

import { choice, choose, onChoice } from "./choice.js";
import { drawLanes, startLanes, stateColour } from "./lanes.js";
import { resizeMap, startMap } from "./map.js";
import { drawPairs, startPairs } from "./pairs.js";
import { drawResiduals, startResiduals } from "./residuals.js";
import { element } from "./svg.js";
import { startTables } from "./tables.js";
import { end, users, values } from "./values.js";
import { number } from "./words.js";

const byId = (id) => document.getElementById(id);
const PLAYED_S = 40;

function startHead() {
  byId("title").textContent = values.title;
  const { used, rejected, unusable } = values.counts;
  const parts = [
    `${users.length} devices, ${used + rejected + unusable} ranges in ${number(end, 1)} s: ${used} used, ${rejected} rejected, ${unusable} unusable`,
    values.causal ? "as it was known while they moved (replay)" : `model ${values.model}, ${values.method}`,
    `reference ${values.reference || "none"}`,
    `σ of a range ${number(values.sigma, 2)} m`,
  ];
  if (values.every_range > 1) parts.push(`one range in ${values.every_range} is drawn, figures are of all`);
  if (values.every_pose > 1) parts.push(`one pose in ${values.every_pose} is drawn`);
  byId("summary").textContent = `${parts.join("; ")}.`;
  byId("findings").append(
    ...values.findings.map((finding) => {
      const item = document.createElement("li");
      item.textContent = `${finding.user ? `${finding.user}: ` : ""}${finding.message}. ${finding.remedy}`;
      return item;
    }),
  );
}

function startControls() {
  const [time, play] = [byId("time"), byId("play")];
  time.max = String(Math.ceil(10 * end) / 10);
  const show = () => {
    time.value = String(choice.t);
    byId("now").textContent = `${number(choice.t, 1)} s`;
    byId("clear").disabled = choice.user === null && choice.pair === null;
  };
  onChoice(show);
  show();
  time.addEventListener("input", () => choose({ t: Number(time.value) }));
  byId("span").value = String(choice.span);
  byId("span").addEventListener("change", (event) => choose({ span: Number(event.target.value) }));
  byId("trails").addEventListener("change", (event) => choose({ trails: event.target.checked }));
  byId("rejected").addEventListener("change", (event) => choose({ rejected: event.target.checked }));
  byId("clear").addEventListener("click", () => choose({ user: null, pair: null }));
  play.addEventListener("click", () => setPlaying(play.getAttribute("aria-pressed") !== "true"));
  let last = null;
  const step = (now) => {
    if (play.getAttribute("aria-pressed") !== "true") return;
    if (last !== null) choose({ t: choice.t + ((now - last) / 1000) * Math.max(1, end / PLAYED_S) });
    last = now;
    if (choice.t >= end) setPlaying(false);
    else requestAnimationFrame(step);
  };
  function setPlaying(playing) {
    play.setAttribute("aria-pressed", String(playing));
    play.textContent = playing ? "Pause" : "Play";
    if (!playing) return;
    last = null;
    if (choice.t >= end) choose({ t: 0 });
    requestAnimationFrame(step);
  }
}

function entryOf(legend, draw, text) {
  const item = document.createElement("span");
  const sample = element("svg", { viewBox: "0 0 26 14" });
  draw(sample);
  item.append(sample, text);
  legend.append(item);
}

function startLegends() {
  const legend = byId("legend");
  const classes = ["residual below −3 σ", "−3 to −2 σ", "−2 to −1 σ", "within 1 σ", "1 to 2 σ", "2 to 3 σ", "above 3 σ"];
  classes.forEach((text, n) => {
    entryOf(legend, (sample) => (element("path", { d: "M1 7h24", "stroke-width": 3 }, sample).style.stroke = `var(--r${n})`), text);
  });
  const ink = { stroke: "var(--ink)", fill: "none" };
  entryOf(legend, (sample) => element("path", { ...ink, d: "M1 7h24", "stroke-width": 1.5, "stroke-dasharray": "4 3" }, sample), "rejected range");
  entryOf(legend, (sample) => element("path", { ...ink, d: "M9 3l8 8m0 -8l-8 8", "stroke-width": 2.4 }, sample), "SLAM jumped");
  entryOf(legend, (sample) => element("path", { d: "M13 1l7 12h-14z", fill: "var(--u9)" }, sample), "static radio");
  entryOf(legend, (sample) => element("ellipse", { ...ink, cx: 13, cy: 7, rx: 11, ry: 5.5 }, sample), "95 % region");
  if (users.some((user) => user.others.length)) {
    entryOf(legend, (sample) => element("path", { ...ink, d: "M1 7h24", "stroke-dasharray": "2 4" }, sample), "another placement that fits");
  }
  const lanes = byId("lanes-legend");
  const heights = [12, 8, 5, 1.5];
  values.states.forEach((state, n) => {
    const bar = { x: 1, y: 7 - (values.causal ? heights[n] : 12) / 2, width: 24, height: values.causal ? heights[n] : 12 };
    entryOf(lanes, (sample) => (element("rect", bar, sample).style.fill = stateColour(n)), state);
  });
  if (values.causal) {
    entryOf(lanes, (sample) => element("path", { ...ink, d: "M1 12h8v-5h8v-5h8" }, sample), "progress");
    entryOf(lanes, (sample) => element("path", { d: "M9 4h8l-4 7z", fill: "var(--ink)" }, sample), "event");
  } else {
    entryOf(lanes, (sample) => element("rect", { x: 1, y: 4, width: 24, height: 9, fill: "var(--r5)" }, sample), "share of rejected ranges");
  }
}

function redraw() {
  resizeMap();
  drawLanes();
  drawResiduals();
  drawPairs();
}

startHead();
startControls();
startLegends();
startMap();
startLanes();
startResiduals();
startPairs();
startTables();
resizeMap();
let width = document.documentElement.clientWidth;
new ResizeObserver(() => {
  if (document.documentElement.clientWidth === width) return;
  width = document.documentElement.clientWidth;
  redraw();
}).observe(document.documentElement);
