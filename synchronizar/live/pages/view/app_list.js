/** What can be done in rooms of this server: a button each, which opens one more room for it. */

import { element } from "../dom.js";

export class AppList {
  #section;
  #list;
  #server;
  #code;

  constructor(section, list, server, code) {
    this.#section = section;
    this.#list = list;
    this.#server = server;
    this.#code = code;
  }

  /** Asks the server; where there is nothing, nothing is shown. */
  async show() {
    const answer = await fetch(new URL("api/apps", this.#server)).catch(() => null);
    const apps = answer?.ok ? await answer.json() : {};
    this.#section.hidden = Object.keys(apps).length === 0;
    this.#list.replaceChildren(...Object.entries(apps).map(([name, app]) => this.#item(name, app)));
  }

  #item(name, { title, summary }) {
    const open = element("button", { type: "button", text: title });
    const told = element("p", { class: "quiet", text: summary, role: "status" });
    open.addEventListener("click", async () => {
      open.disabled = true;
      const body = JSON.stringify({ room: this.#code, app: name });
      const answer = await fetch(new URL("api/rooms", this.#server), { method: "POST", body }).catch(() => null);
      const opened = await answer?.json().catch(() => null);
      open.disabled = false;
      if (answer?.ok) location.assign(`room#${opened.room}`);
      else told.textContent = opened?.what ?? "The room's computer does not answer. Try again.";
    });
    return element("li", {}, open, told);
  }
}
