/** Who looks through whose eyes, in words. No elements, no drawing. */

export const LOOK = "look";

/** The room's objects of a kind. */
export function ofKind(client, kind) {
  return [...client.objects.values()].filter((object) => object.kind === kind);
}

/** Everybody whose eyes `name` may ask for, and how that stands: [{whom, state, line, act, button}]. `name` "": the room's page. */
export function others(client, name) {
  const looks = ofKind(client, LOOK).map(({ data }) => data);
  return [...client.members.values()]
    .filter((member) => member.here && !member.static && member.name !== name)
    .sort((a, b) => a.index - b.index)
    .map(({ name: whom }) => {
      const state = looks.find((look) => look.who === name && look.whom === whom)?.state ?? null;
      return { whom, state, ...worded(whom, state) };
    });
}

function worded(whom, state) {
  switch (state) {
    case "asked":
      return { line: `${whom} has been asked.`, act: "stop", button: "Take back" };
    case "on":
      return { line: `You see what ${whom} sees.`, act: "stop", button: "Look no more" };
    case "refused":
      return { line: `${whom} says no.`, act: null, button: null };
    default:
      return { line: whom, act: "ask", button: "See through these eyes" };
  }
}

/** Those who ask for, or have, the eyes of `name`: [{who, on, line}]. */
export function lookers(client, name) {
  return ofKind(client, LOOK)
    .map(({ data }) => data)
    .filter(({ whom, state }) => whom === name && state !== "refused")
    .map(({ who, state }) => ({ who, on: state === "on", line: asking(who, state) }));
}

function asking(who, state) {
  if (state === "on") return who ? `${who} sees what you see.` : "Everybody at the room's page sees what you see.";
  return who ? `${who} asks to see what you see.` : "The room's page asks to show everybody what you see.";
}
