/** The phone's page: walk in with AR, then see the others and the room's objects where they are. */

import { appLayer } from "../app_layer.js";
import { UPRIGHT_IN_Y_UP, turned } from "../axes.js";
import { stampOf } from "../clock.js";
import { byId, say } from "../dom.js";
import { JoinError, RoomClient } from "../protocol.js";
import { Banner } from "../view/banner.js";
import { colourOf } from "../view/colours.js";
import { addressOf, codeOf, recalled, remember, serverAddress, spelled } from "../visit.js";
import { connection, metres } from "../words.js";
import { canShowAr } from "./ability.js";
import { Anchors } from "./anchors.js";
import { Avatars } from "./avatars.js";
import { Holding } from "./holding.js";
import { Objects } from "./objects.js";
import { Overlay } from "./overlay.js";
import { OwnFrame } from "./own_frame.js";
import { Picture } from "./picture.js";
import { ArSession } from "./session.js";
import { Stage } from "./stage.js";

/** m in front of the device, where a marker is put. */
const MARK_AHEAD = 1;
const REDRAW_MS = 200;

const code = codeOf();
const { name, resume } = recalled(code);
const banner = new Banner(byId("banner"));
let layer = null;

async function prepare() {
  say(byId("title"), name ? `Walk into room ${spelled(code)} as ${name}` : "Walk in");
  byId("look").href = addressOf("room", code);
  byId("back").href = addressOf("./", code);
  if (!code || !name) {
    location.replace(addressOf("./", code));
    return;
  }
  const able = await canShowAr();
  if (!able.ar) {
    remember(code, { note: able.why.replace("You can look all the same.", "So you are looking.") });
    location.replace(addressOf("room", code));
    return;
  }
  byId("enter").addEventListener("click", walk);
  try {
    layer = await appLayer(await appOfRoom(), "phone");
  } catch (error) {
    if (!(error instanceof JoinError)) throw error; // the click says what is wrong
  }
  byId("enter").disabled = false;
}

/** What is done in the room: AR is asked for what that wants, and can be asked once only, within the click. */
async function appOfRoom() {
  const client = new RoomClient({ server: serverAddress(), room: code });
  const { app } = await client.connect();
  client.close();
  return app;
}

async function walk() {
  byId("enter").disabled = true;
  banner.hide();
  const visit = new Visit();
  try {
    await visit.start();
  } catch (error) {
    visit.end();
    const text = error instanceof JoinError ? error.message : `AR could not be started: ${error.message}`;
    const way = error.reason === "name" || error.reason === "room" ? addressOf("./", code) : null;
    banner.show(text, "error", way && { label: "Change it", go: () => location.assign(way) });
  }
}

/** From the click that starts AR until it ends. */
class Visit {
  #stage = new Stage();
  #session = new ArSession();
  #client = new RoomClient({ server: serverAddress(), room: code, users: [{ name, up: "y" }], resume: resume ?? null });
  #frame = new OwnFrame(this.#client);
  #avatars = new Avatars(this.#client, this.#stage.common);
  #holding = new Holding(this.#client);
  #anchors = new Anchors(this.#session);
  #objects = new Objects(this.#client, this.#stage.common, this.#stage.scene, this.#holding, this.#anchors);
  #overlay = new Overlay({ leave: () => this.end(true), mark: () => this.mark() });
  #picture = new Picture(this.#stage);
  #app = null;
  #own = null;
  #placing = null;
  #drawnAt = null;
  #timer = null;

  constructor() {
    /** For tests and the browser's console. */
    globalThis.synchronizar = {
      client: this.#client,
      frame: this.#frame,
      avatars: this.#avatars,
      objects: this.#objects,
      holding: this.#holding,
      anchors: this.#anchors,
      stage: this.#stage,
      overlay: this.#overlay,
    };
  }

  async start() {
    document.body.append(this.#stage.renderer.domElement);
    this.#listen();
    // A browser starts AR from within a click only, so that comes first.
    const draw = (...frame) => this.#draw(...frame);
    await this.#session.start(this.#stage.renderer, byId("overlay"), draw, layer?.features);
    const { app } = await this.#client.connect();
    layer ??= await appLayer(app, "phone");
    this.#beginApp();
    remember(code, { resume: this.#client.resume });
    byId("start").hidden = true;
    this.#overlay.show(true);
    this.#timer = setInterval(() => this.#refresh(), REDRAW_MS);
    this.#refresh();
  }

  /** What is done in the room draws and hears as well. */
  #beginApp() {
    if (!layer.begin) return;
    this.#app = layer.begin({
      client: this.#client,
      name,
      common: this.#stage.common,
      panel: byId("app"),
      avatars: this.#avatars,
      frame: this.#frame,
      own: () => this.#own,
      registered: () => this.#frame.registered,
      picture: this.#picture,
    });
    globalThis.synchronizar.app = this.#app;
    this.#objects.leave(this.#app.kinds ?? new Set());
    byId("mark").hidden = true;
  }

  /** Ends AR and the connection; `left`: the device does not come back. */
  end(left = false) {
    if (left) {
      this.#client.leave();
      remember(code, { resume: null });
    } else {
      this.#client.close();
    }
    clearInterval(this.#timer);
    this.#app?.end?.();
    this.#session.end()?.catch(() => {});
    this.#picture.dispose();
    this.#stage.renderer.domElement.remove();
    this.#stage.renderer.dispose();
    this.#overlay.show(false);
    byId("start").hidden = false;
    byId("enter").disabled = false;
  }

  /** Puts a marker in front of the device; the room places it once it knows where that is. */
  mark() {
    if (!this.#own) return;
    const ahead = turned(this.#own.quat_xyzw, [0, 0, -MARK_AHEAD]);
    const position = this.#own.position.map((v, i) => v + ahead[i]);
    const id = this.#client.create({ kind: "marker", user: name, position, quat_xyzw: UPRIGHT_IN_Y_UP });
    this.#objects.wait(id, "marker", position, colourOf(this.#client.member(name)?.index ?? 0, true));
    if (!this.#frame.registered) this.#overlay.notice("The others see your marker once the room knows where you are.");
  }

  #listen() {
    const session = this.#session;
    session.addEventListener("pose", ({ detail: { t, position, quat_xyzw } }) => {
      this.#own = { position, quat_xyzw };
      this.#frame.moveTo(position);
      this.#client.sendPose(position, quat_xyzw, stampOf(t));
      this.#app?.pose?.(t, position);
    });
    session.addEventListener("selectstart", () => this.#app?.select?.start());
    session.addEventListener("selectend", () => this.#app?.select?.end());
    // Where something is done in the room, what a finger does there is its own.
    session.addEventListener("take", ({ detail }) => {
      if (this.#app?.select || !this.#placing || !this.#frame.registered) return;
      this.#holding.take(detail.hand, detail, this.#placing);
    });
    session.addEventListener("hold", ({ detail }) => {
      if (this.#placing) this.#holding.follow(detail.hand, detail, this.#placing, detail.t / 1000);
    });
    session.addEventListener("let", ({ detail }) => this.#holding.let(detail.hand));
    session.addEventListener("reset", () => {
      this.#holding.letAll();
      this.#anchors.clear();
      this.#frame.forget();
      this.#client.reset();
      this.#overlay.notice("The phone has begun anew to see where it is. Walk a few metres.");
    });
    session.addEventListener("lost", () => {
      this.#client.lost();
      this.#overlay.notice("The phone does not see where it is. Point the camera at something with edges, in good light.");
    });
    session.addEventListener("end", () => this.#client.state !== "closed" && this.#ended());
    this.#frame.addEventListener("moved", ({ detail }) =>
      this.#overlay.notice(`Things have moved by ${metres(detail.distance, 1)}: the room knows better now where you are.`),
    );
    this.#client.addEventListener("state", ({ detail }) => {
      const text = connection(detail);
      if (detail.state === "waiting") this.#overlay.notice(text);
      if (detail.state === "closed" && ["elsewhere", "room", "protocol"].includes(detail.reason)) this.#ended(text);
    });
    this.#client.addEventListener("refused", ({ detail }) => this.#overlay.notice(detail.what));
    document.addEventListener("visibilitychange", () => document.visibilityState === "visible" && this.#client.wake());
  }

  #ended(text = "AR has ended. You come back as the same device.") {
    remember(code, { resume: this.#client.resume });
    this.end();
    banner.show(text, "note", { label: "Go on", go: () => location.reload() });
  }

  #draw(time, frame, space) {
    const dt = this.#drawnAt === null ? 0 : Math.min(0.2, Math.max(0, (time - this.#drawnAt) / 1000));
    this.#drawnAt = time;
    const placing = this.#frame.step(dt, this.#stage.inView);
    this.#placing = placing;
    this.#stage.place(placing);
    const { roomTime } = this.#client;
    if (roomTime !== null) this.#avatars.update(roomTime, this.#frame.opacity);
    this.#objects.update(dt, roomTime, this.#frame.opacity, placing, this.#own?.position ?? [0, 0, 0]);
    this.#app?.frame?.(frame, space, time);
    this.#app?.update?.(dt, roomTime);
    this.#stage.draw();
  }

  #refresh() {
    const others = Object.values(this.#avatars.places).filter(({ state }) => state === "registered").length;
    this.#overlay.update(name, this.#frame.told, others, this.#objects.waiting);
  }
}

prepare();
