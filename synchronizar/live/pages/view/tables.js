/** Everything that the canvas shows, and more, as tables: for readers of the screen, and for who wants numbers. */

import { element, keep, say } from "../dom.js";
import { STATES, metres, rate, stateOf } from "../words.js";

const DEVICE_COLUMNS = [
  ["Device", (user) => user.name],
  ["State", (user) => (user.here ? STATES[stateOf(user.told)].label : "away")],
  ["Place x, y, z (m)", (user) => place(user.pose)],
  ["Looks (°)", (user) => degrees(user.pose?.heading)],
  ["± 1 sigma", (user) => metres(user.told?.sigma)],
  ["Poses /s", (user) => rate(user.health?.poses_hz)],
  ["Ranges /s", (user) => rate(user.health?.ranges_hz)],
  ["Latency", (user) => milliseconds(user.health?.latency_ms)],
  ["Module", (user) => (user.health ? (user.health.asleep ? "asleep" : "awake") : "–")],
  ["Refused", (user) => counts(user.health?.refused)],
  ["Why", (user) => user.told?.reason ?? ""],
];

const PAIR_COLUMNS = [
  ["Pair", ({ a, b }) => `${a} – ${b}`],
  ["Distance", ({ distance }) => metres(distance)],
  ["Residual", ({ residual }) => (residual === null ? "–" : signed(residual))],
  ["Used", ({ used }) => (used ? "yes" : "no")],
  ["Age", ({ age }) => `${age.toFixed(1)} s`],
];

/** One table, filled anew whenever it is told. */
class Table {
  #body;
  #columns;

  constructor(table, columns) {
    this.#columns = columns;
    const head = element("tr", {}, ...columns.map(([title]) => element("th", { scope: "col", text: title })));
    this.#body = element("tbody");
    table.append(element("thead", {}, head), this.#body);
  }

  update(rows, keyOf) {
    const make = () =>
      element("tr", {}, ...this.#columns.map((_, i) => (i ? element("td") : element("th", { scope: "row" }))));
    const fill = (row, item) => this.#columns.forEach(([, cell], i) => say(row.cells[i], cell(item)));
    keep(this.#body, rows, keyOf, make, fill);
  }
}

export class Tables {
  #devices;
  #pairs;

  constructor(devices, pairs) {
    this.#devices = new Table(devices, DEVICE_COLUMNS);
    this.#pairs = new Table(pairs, PAIR_COLUMNS);
  }

  update(model) {
    this.#devices.update(model.present, (user) => user.index);
    this.#pairs.update(model.pairs, ({ a, b }) => `${a}\n${b}`);
  }
}

/** "future 3, rate 12", or "0". */
export function counts(refused) {
  const entries = Object.entries(refused ?? {});
  return entries.length ? entries.map(([reason, count]) => `${reason} ${count}`).join(", ") : "0";
}

function place(pose) {
  return pose ? [pose.x, pose.y, pose.z].map((v) => v.toFixed(2)).join(", ") : "–";
}

function degrees(angle) {
  return Number.isFinite(angle) ? `${Math.round((angle * 180) / Math.PI)}` : "–";
}

function milliseconds(value) {
  return Number.isFinite(value) ? `${value.toFixed(0)} ms` : "–";
}

function signed(value) {
  return `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(2)} m`;
}
