/** The room's page: who only looks sees everybody from above. */

import { appLayer } from "../app_layer.js";
import { byId, say } from "../dom.js";
import { JoinError, RoomClient } from "../protocol.js";
import { Banner } from "../view/banner.js";
import { onDarkChange } from "../view/colours.js";
import { Devices } from "../view/devices.js";
import { EventLog } from "../view/events.js";
import { AppList } from "../view/app_list.js";
import { fillJoinCard } from "../view/join_card.js";
import { Tables, counts } from "../view/tables.js";
import { TopView } from "../view/top_view.js";
import { addressOf, codeOf, recalled, remember, serverAddress, spelled } from "../visit.js";
import { connection, duration, sentence, stateOf } from "../words.js";
import { RoomModel } from "./model.js";

const REDRAW_MS = 250;
/** s: a solver that is so far behind is told. */
const BEHIND_S = 10;

const code = codeOf();
const banner = new Banner(byId("banner"));
const client = new RoomClient({ server: serverAddress(), room: code });
const model = new RoomModel(client);
const devices = new Devices(byId("devices"), byId("nobody"));
const tables = new Tables(byId("device-table"), byId("pair-table"));
const log = new EventLog(byId("events"));
const view = new TopView(byId("top-view"), model);
const apps = new AppList(byId("other-apps"), byId("app-list"), serverAddress(), code);
let app = null;
let began = null;
let troubled = false;

/** For tests and the browser's console. */
globalThis.synchronizar = { client, model };

say(byId("title"), code ? `Room ${spelled(code)}` : "Room");
document.title = code ? `Room ${spelled(code)}` : document.title;
byId("fit").addEventListener("click", () => view.fit());
byId("closer").addEventListener("click", () => view.zoom(1.25));
byId("farther").addEventListener("click", () => view.zoom(0.8));
byId("full").addEventListener("click", () => document.documentElement.requestFullscreen?.());
byId("full").hidden = !document.documentElement.requestFullscreen;
byId("walk-in").href = addressOf("./", code);
onDarkChange(refresh);

client.addEventListener("welcome", ({ detail }) => {
  began ??= detail.t;
  showApp(detail.app);
});
client.addEventListener("state", ({ detail }) => {
  const text = connection(detail);
  if (!text) banner.hide();
  else if (detail.state === "closed") banner.show(text, "error", { label: "Join again", go: () => location.reload() });
  else banner.show(text, "wait");
  byId("connected").dataset.state = detail.state;
  say(byId("connected"), { open: "connected", joining: "joining …", waiting: "reconnecting …" }[detail.state] ?? "not connected");
  const { note } = recalled(code);
  if (detail.state === "open" && note) {
    banner.show(note, "note", { label: "I see", go: () => (remember(code, { note: "" }), banner.hide()) });
  }
});
document.addEventListener("visibilitychange", () => document.visibilityState === "visible" && client.wake());
addEventListener("hashchange", () => location.reload());

function refresh() {
  devices.update(model.present);
  tables.update(model);
  log.update(model.events, elapsed);
  counters();
  app?.refresh?.();
}

async function showApp(name) {
  if (app || !name) return;
  const { begin } = await appLayer(name, "room");
  if (app || !begin) return;
  byId("app").hidden = false;
  app = begin({ client, model, panel: byId("app") });
  view.above = app.draw ? (paint, camera) => app.draw(paint, camera) : null;
}

function counters() {
  const { status } = client;
  tellOfSolver(client.state === "open" && model.users.size > 0 ? status : null);
  const users = model.present;
  const registered = users.filter((user) => stateOf(user.told) === "registered").length;
  say(byId("count-registered"), `${registered} of ${users.length}`);
  const sum = (of) => (status ? Object.values(status.users).reduce((total, health) => total + health[of], 0) : null);
  say(byId("count-poses"), status ? `${Math.round(sum("poses_hz"))} /s` : "–");
  say(byId("count-ranges"), status ? `${Math.round(sum("ranges_hz") / 2)} /s` : "–");
  say(byId("count-behind"), status ? duration(status.behind) : "–");
  say(byId("count-refused"), counts(status?.refused));
  say(byId("count-latency"), client.roundTrip === null ? "–" : `${Math.round(500 * client.roundTrip)} ms`);
}

function tellOfSolver(status) {
  const slow = "The room's solver is far behind: its computer is too slow for so many devices, or it is being started anew.";
  const text = status?.solver ? `${sentence(status.solver)}.` : status?.behind > BEHIND_S ? slow : null;
  if (text !== null) banner.show(text, "warn");
  else if (troubled) banner.hide();
  troubled = text !== null;
}

function elapsed(t) {
  const seconds = Math.max(0, Math.round(t - (began ?? t)));
  return `${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, "0")}`;
}

async function start() {
  if (!code) {
    location.replace("./");
    return;
  }
  fillJoinCard({ image: byId("qr"), address: byId("address"), code: byId("code") }, serverAddress(), code);
  try {
    await client.connect();
  } catch (error) {
    if (!(error instanceof JoinError)) throw error;
    const elsewhere = { label: "Enter the code again", go: () => location.assign("./") };
    banner.show(error.message, "error", error.reason === "room" ? elsewhere : { label: "Try again", go: () => location.reload() });
  }
  apps.show();
  refresh();
  setInterval(refresh, REDRAW_MS);
}

start();
