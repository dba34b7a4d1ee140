/** Eyes on the room's page: the room's model to walk about in, others' views, marks, stored scans. */

import { element, keep, say } from "../../pages/dom.js";
import { ofKind, others } from "../../pages/looks.js";
import { Gallery } from "../../pages/stills.js";
import { SpaceView } from "../../pages/view/space_view.js";
import { entry, entryKey, sayLine } from "../../pages/xr/looking.js";
import { Screen } from "../../pages/xr/screen.js";
import { Cloud, drawn } from "./cloud.js";
import { SCAN } from "./kinds.js";
import { Marks } from "./marks.js";
import { Stored } from "./stored.js";
import { Model, onFloor } from "./voxels.js";

const NOBODY = "";
/** ms between two words of a stored scan: a room hands on so much a second. */
const WORDS_MS = 150;
/** m ahead, where one looks at no floor. */
const AHEAD_M = 3;

/** `place`: what the room's page has, see docs/apps.md. */
export function begin({ client, panel }) {
  const [model, cloud, marks, gallery] = [new Model(client), new Cloud(), new Marks(), new Gallery()];
  const screens = new Map();
  const view = new SpaceView(client, (origin, way) => {
    const at = model.hit(origin, way, 30) ?? onFloor(origin, way, model.floor, 30);
    if (at) client.say("mark", { position: at }, "app");
  });
  view.canvas.className = "app-space";
  view.canvas.setAttribute("aria-label", "The room in three dimensions. Arrow keys walk, dragging turns, a click marks a place for everybody.");
  view.common.add(cloud.root, marks.root);
  const large = button("Full screen", () => view.canvas.requestFullscreen());
  large.hidden = !view.canvas.requestFullscreen;
  const through = element("select", { id: "eyes-through" });
  const none = element("p", { class: "quiet", text: "Nothing has been scanned yet: phones that see depth do that as they walk." });
  const list = element("ul", { class: "app-list" });
  const clear = button("Empty the model", () => client.say("forget", null, "app"));
  panel.append(
    element("h2", { text: "Look through my eyes" }),
    element("label", { for: "eyes-through", text: "Stand " }),
    through,
    view.canvas,
    element("div", { class: "app-row" }, large, clear),
    none,
    list,
    ...storedScans(client, view, model),
  );
  client.addEventListener("said", ({ detail: { topic, data, by } }) => topic === "eye" && gallery.hear(by, data, now()));

  view.by = () => {
    const member = client.member(through.value);
    const at = member && view.placeOf(member.name);
    return at ? { ...at, up: member.up } : null;
  };
  view.update = () => {
    cloud.update(client);
    marks.update(client);
    for (const { whom, state } of others(client, NOBODY)) show(whom, state === "on" ? gallery.of(whom, now()) : null);
  };

  function show(whom, picture) {
    let screen = screens.get(whom);
    if (!screen && picture) {
      screen = new Screen();
      screens.set(whom, screen);
      view.common.add(screen.root);
    }
    if (picture) screen.show(picture.image, picture.half, picture.aspect);
    screen?.place(picture && through.value !== whom ? view.placeOf(whom) : null, client.member(whom)?.up);
  }

  return {
    /** For tests. */
    view,
    refresh() {
      const told = others(client, NOBODY);
      const places = [{ value: NOBODY, text: "where you walk" }, ...told.map(({ whom }) => ({ value: whom, text: `where ${whom} is` }))];
      keep(through, places, ({ value }) => value, ({ value }) => element("option", { value }), (option, { text }) => say(option, text));
      view.floor = model.floor;
      none.hidden = ofKind(client, SCAN).length > 0;
      clear.hidden = !none.hidden;
      keep(list, told, entryKey, (item) => entry(client, NOBODY, item), sayLine);
    },
  };
}

/** A file that lies on the floor where one looks, turned as one looks, until it is put down. */
function storedScans(client, view, model) {
  const file = element("input", { type: "file", accept: ".glb,model/gltf-binary", id: "eyes-file" });
  const line = element("p", { class: "quiet", role: "status" });
  let [stored, shown] = [null, null];
  const put = button("Put it down here", async () => {
    const words = [...stored.words(where())];
    leave();
    for (const [n, word] of words.entries()) {
      say(line, `It goes into the room: ${Math.round((100 * n) / words.length)} %`);
      client.say("seen", word, "app");
      await new Promise((resolve) => setTimeout(resolve, WORDS_MS));
    }
    say(line, "It is in the room's model.");
  });
  const cancel = button("Take it away", () => {
    leave();
    say(line, "");
  });
  put.hidden = cancel.hidden = true;
  file.addEventListener("change", async () => {
    const [chosen] = file.files;
    if (!chosen) return;
    leave();
    try {
      stored = new Stored(await chosen.arrayBuffer());
      [put, cancel].forEach((each) => (each.hidden = false));
      say(line, "It lies on the floor where you look, and turns as you do.");
      follow();
    } catch (error) {
      say(line, error.message);
    }
    file.value = "";
  });

  function where() {
    const { origin, way } = view.ray();
    const position = onFloor(origin, way, model.floor, 30) ?? [origin[0] + AHEAD_M * way[0], origin[1] + AHEAD_M * way[1], model.floor];
    return { position, yaw: Math.atan2(way[1], way[0]) };
  }

  function follow() {
    if (!stored) return;
    const { position, yaw } = where();
    if (!shown) {
      shown = drawn(stored.shown({ position: [0, 0, 0], yaw: 0 }));
      view.common.add(shown);
    }
    shown.position.set(...position);
    shown.rotation.set(0, 0, yaw);
    requestAnimationFrame(follow);
  }

  function leave() {
    if (shown) {
      view.common.remove(shown);
      shown.geometry.dispose();
      shown.material.dispose();
    }
    [stored, shown] = [null, null];
    put.hidden = cancel.hidden = true;
  }

  return [element("label", { for: "eyes-file", text: "Add a stored scan (.glb)" }), file, line, element("div", { class: "app-row" }, put, cancel)];
}

function button(text, act) {
  const made = element("button", { type: "button", text });
  made.addEventListener("click", act);
  return made;
}

function now() {
  return performance.now() / 1000;
}
