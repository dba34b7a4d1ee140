/** Eyes on the room's page: the room's model to walk about in, others' views, marks. */

import { element, keep, say } from "../../pages/dom.js";
import { SpaceView } from "../../pages/view/space_view.js";
import { Cloud } from "./cloud.js";
import { ofKind, others, SCAN } from "./looks.js";
import { Marks } from "./marks.js";
import { Screen } from "./screen.js";
import { Gallery } from "./stills.js";
import { Model, onFloor } from "./voxels.js";

const NOBODY = "";

/** `place`: what the room's page has, see docs/apps.md. */
export function begin({ client, panel }) {
  const [model, cloud, marks, gallery] = [new Model(), new Cloud(), new Marks(), new Gallery()];
  const screens = new Map();
  const view = new SpaceView(client, (origin, way) => {
    const at = model.hit(origin, way, 30) ?? onFloor(origin, way, model.floor, 30);
    if (at) client.say("mark", { position: at }, "app");
  });
  view.canvas.className = "app-space";
  view.canvas.setAttribute("aria-label", "The room in three dimensions. Arrow keys walk, dragging turns, a click marks a place for everybody.");
  view.common.add(cloud.root, marks.root);
  const large = element("button", { type: "button", text: "Full screen" });
  large.hidden = !view.canvas.requestFullscreen;
  large.addEventListener("click", () => view.canvas.requestFullscreen());
  const through = element("select", { id: "eyes-through" });
  const none = element("p", { class: "quiet", text: "Nothing has been scanned yet: phones that see depth do that as they walk." });
  const list = element("ul", { class: "app-list" });
  panel.append(
    element("h2", { text: "Look through my eyes" }),
    element("label", { for: "eyes-through", text: "Stand " }),
    through,
    view.canvas,
    large,
    none,
    list,
  );
  client.addEventListener("said", ({ detail: { topic, data, by } }) => topic === "eye" && gallery.hear(by, data, now()));

  view.by = () => {
    const member = client.member(through.value);
    const at = member && view.placeOf(member.name);
    return at ? { ...at, up: member.up } : null;
  };
  view.update = () => {
    cloud.update(client, model);
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
    refresh() {
      const told = others(client, NOBODY);
      const places = [{ value: NOBODY, text: "where you walk" }, ...told.map(({ whom }) => ({ value: whom, text: `where ${whom} is` }))];
      keep(through, places, ({ value }) => value, ({ value }) => element("option", { value }), (option, { text }) => say(option, text));
      view.floor = model.floor;
      none.hidden = ofKind(client, SCAN).length > 0;
      keep(list, told, ({ whom, state }) => `${state} ${whom}`, (item) => entry(client, item), (item, { line }) => say(item.firstChild, line));
    },
  };
}

function entry(client, { whom, line, act, button: text }) {
  const go = element("button", { type: "button", text: text ?? "", hidden: act === null });
  go.addEventListener("click", () => client.say(act, act === "stop" ? { who: NOBODY, whom } : { whom }, "app"));
  return element("li", {}, element("span", { text: line }), go);
}

function now() {
  return performance.now() / 1000;
}
