// Figures as tables, for reading, for searching and for print.

import { choice, onChoice, togglePair, toggleUser } from "./choice.js";
import { goToJump } from "./map.js";
import { shareOf } from "./pairs.js";
import { element, lineOf } from "./svg.js";
import { events, jumps, pairKey, pairs, users, values } from "./values.js";
import { degrees, number } from "./words.js";

const rows = new Map();

export function startTables() {
  drawUserTable();
  drawJumpTable();
  drawPairTable();
  drawEvents();
  onChoice((changed) => (changed.has("user") || changed.has("pair")) && markRows());
}

function fill(table, head, lines) {
  const header = document.createElement("thead");
  header.append(rowOf("th", head, []));
  const body = document.createElement("tbody");
  body.append(...lines);
  table.replaceChildren(header, body);
}

// A row; cells that begin with "<" stand to the left.
function rowOf(kind, cells, classes) {
  const row = document.createElement("tr");
  cells.forEach((cell, n) => {
    const made = document.createElement(kind);
    if (kind === "th") made.scope = "col";
    if (typeof cell === "string" && cell.startsWith("<")) {
      made.className = classes[n] ?? "left";
      made.textContent = cell.slice(1);
    } else {
      made.append(cell);
      if (typeof cell !== "string") made.className = "left";
    }
    row.append(made);
  });
  return row;
}

function button(text, action) {
  const made = document.createElement("button");
  made.type = "button";
  made.setAttribute("aria-pressed", "false");
  made.textContent = text;
  made.addEventListener("click", action);
  return made;
}

function withSigma(value, sigma, digits, unit = 1) {
  if (value === null || value === undefined) return "–";
  const off = sigma === null || sigma === undefined ? "" : `\u00a0±${number(sigma / unit, digits)}`;
  return number(value / unit, digits) + off;
}

function drawUserTable() {
  const head = ["<Device", "<State", "± xy (m)", "± z (m)", "± yaw (°)", "Scale", "Radio bias (m)", "Clock (ms)"];
  if (!values.causal) head.push("SLAM drifted (m)");
  head.push("Jumps", "Used", "Rejected", "<Why");
  const lines = users.map((user) => {
    const name = button(user.name, () => toggleUser(user.index));
    const sample = element("svg", { viewBox: "0 0 30 12" });
    lineOf(user, { class: "line", "stroke-width": 3, d: user.static ? "M15 2l5 8h-10z" : "M1 6h28" }, sample);
    const who = document.createElement("span");
    who.append(sample, name);
    const of = [...pairs.values()].filter((pair) => pair.a === user.index || pair.b === user.index);
    const sum = (what) => of.reduce((total, pair) => total + pair[what], 0);
    const share = sum("rejected") / (sum("used") + sum("rejected") || 1);
    const cells = [
      who,
      `<${values.states[user.state]}${user.name === values.reference ? ", reference" : ""}`,
      number(user.ellipse?.[0], 2),
      number(user.height_sigma, 2),
      user.static ? "–" : degrees(user.yaw_sigma),
      user.static ? "–" : withSigma(user.scale, user.sigma?.scale, 3),
      withSigma(user.range_bias, user.sigma?.range_bias, 3) + byPrior(user, "range_bias"),
      withSigma(user.clock_offset, user.sigma?.clock_offset, 0, 1e-3) + byPrior(user, "clock_offset"),
    ];
    if (!values.causal) cells.push(number(user.drift, 2));
    cells.push(String(user.jumps.length), String(sum("used")), `${sum("rejected")}\u00a0(${number(100 * share, 0)}\u00a0%)`, `<${user.reason}`);
    const row = rowOf("td", cells, { [cells.length - 1]: "why" });
    rows.set(user.index, row);
    return row;
  });
  fill(document.getElementById("users"), head, lines);
  document.getElementById("users-note").textContent =
    "±: 1σ; of the place along the longest axis of its ellipse at the end. *: a prior determines it. A name shows that device alone.";
}

const byPrior = (user, what) => (user.prior_dominated.includes(what) ? "\u00a0*" : "");

function drawJumpTable() {
  document.getElementById("jumps-title").textContent = jumps.length ? `Jumps of SLAM: ${jumps.length}` : "SLAM never jumped";
  if (!jumps.length) return;
  const lines = jumps.map((jump) => {
    const go = button(number(jump.t, 1), () => goToJump(jump));
    go.removeAttribute("aria-pressed");
    return rowOf("td", [go, `<${users[jump.user].name}`, number(jump.distance, 2), degrees(jump.turn, 1, true), degrees(jump.tilt)], []);
  });
  fill(document.getElementById("jumps"), ["<At (s)", "<Device", "By (m)", "Turn (°)", "Tilt (°)"], lines);
}

function drawPairTable() {
  const worst = [...pairs.values()].sort((a, b) => (b.rms ?? Infinity) - (a.rms ?? Infinity));
  const lines = worst.map((pair) => {
    const name = button(`${users[pair.a].name} – ${users[pair.b].name}`, () => togglePair(pair.a, pair.b));
    const row = rowOf("td", [
      name,
      number(pair.rms, 3),
      number(pair.mean, 3, true),
      number(pair.worst, 2, true),
      number(pair.distance, 2),
      String(pair.used),
      `${pair.rejected}\u00a0(${number(100 * shareOf(pair), 0)}\u00a0%)`,
      String(pair.unusable),
    ], []);
    rows.set(`pair ${pairKey(pair.a, pair.b)}`, row);
    return row;
  });
  const head = ["<Pair", "RMS (m)", "Mean (m)", "Worst (m)", "Median range (m)", "Used", "Rejected", "Unusable"];
  fill(document.getElementById("pair-table"), head, lines);
}

function drawEvents() {
  document.getElementById("events-part").hidden = !events.length;
  document.getElementById("events").append(
    ...events.map(([t, text]) => {
      const item = document.createElement("li");
      item.textContent = `${number(t, 1)} s  ${text}`;
      return item;
    }),
  );
}

function markRows() {
  const pair = choice.pair && `pair ${pairKey(...choice.pair)}`;
  for (const [of, row] of rows) {
    const chosen = of === choice.user || of === pair;
    row.classList.toggle("chosen", chosen);
    row.querySelector("button").setAttribute("aria-pressed", String(chosen));
  }
}
