/** The page by which people come in: the room's code, a name, and whether they walk or look. */

import { byId, say } from "../dom.js";
import { JoinError, join } from "../protocol.js";
import { Banner } from "../view/banner.js";
import { addressOf, codeOf, recalled, remember, serverAddress, spelled } from "../visit.js";
import { canShowAr } from "../xr/ability.js";

const banner = new Banner(byId("banner"));
const code = byId("code");
const name = byId("name");

code.value = spelled(codeOf());
name.value = recalled(codeOf()).name ?? "";
(code.value ? name : code).focus();

byId("join").addEventListener("submit", (event) => {
  event.preventDefault();
  walk();
});
byId("look").addEventListener("click", look);
addEventListener("hashchange", () => (code.value = spelled(codeOf())));

canShowAr().then((able) => {
  byId("walk").disabled = !able.ar;
  say(byId("ability"), able.ar ? "" : able.why);
});

/** The code as the room knows it, or "" after having said what is missing. */
function entered() {
  const text = codeOf(`#${code.value}`);
  if (!text) missing(code, "Enter the room's code: eight letters and digits.");
  return text;
}

async function walk() {
  const room = entered();
  if (!room) return;
  const called = name.value.trim();
  if (!called) {
    missing(name, "Enter a name, so that the others know who is where.");
    return;
  }
  if (!(await isRoom(room))) return;
  remember(room, { name: called });
  location.assign(addressOf("phone", room));
}

async function look() {
  const room = entered();
  if (room && (await isRoom(room))) location.assign(addressOf("room", room));
}

/** Whether there is such a room; where not, says so. */
async function isRoom(room) {
  banner.show("Looking for the room …", "wait");
  try {
    await join(serverAddress(), { room });
    banner.hide();
    return true;
  } catch (error) {
    if (!(error instanceof JoinError)) throw error;
    missing(code, `${error.message[0].toUpperCase()}${error.message.slice(1).replace(/\.?$/, ".")}`);
    return false;
  }
}

function missing(field, text) {
  banner.show(text, "error");
  field.setAttribute("aria-invalid", "true");
  field.addEventListener("input", () => field.removeAttribute("aria-invalid"), { once: true });
  field.focus();
}
