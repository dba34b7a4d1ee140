/** The room's words, as sentences for people. */

/** What a state means, and a sign that is told from the others without its colour. */
export const STATES = Object.freeze({
  registered: { label: "in place", sign: "✓", meaning: "Its place in the room is known." },
  ambiguous: { label: "two places possible", sign: "≈", meaning: "More than one place explains the distances." },
  unobservable: { label: "walking in", sign: "…", meaning: "The distances so far do not tell where it is." },
  disconnected: { label: "no distances", sign: "–", meaning: "No distances to the others have come." },
});

/** "0.12 m", or a dash. */
export function metres(value, digits = 2) {
  return Number.isFinite(value) ? `${value.toFixed(digits)} m` : "–";
}

/** "31 /s", or a dash. */
export function rate(value) {
  return Number.isFinite(value) ? value.toFixed(value < 10 ? 1 : 0) : "–";
}

/** "120 ms", "12 s", or that it is long. */
export function duration(seconds) {
  if (seconds < 2) return `${Math.round(1000 * seconds)} ms`;
  return seconds < 600 ? `${Math.round(seconds)} s` : "minutes";
}

/** A sentence's first letter large. */
export function sentence(text) {
  return text ? text[0].toUpperCase() + text.slice(1) : "";
}

/** A told frame's state. The one beside whom the others are found is registered before anybody is: it has no place yet. */
export function stateOf(frame) {
  if (!frame) return "disconnected";
  return frame.state === "registered" && frame.matrix === null ? "unobservable" : frame.state;
}

/** What somebody is to do now, from a told frame. */
export function advice(frame) {
  const state = stateOf(frame);
  if (state === "registered") return "";
  if (frame?.cue) return `${sentence(frame.cue)}.`;
  if (state === "disconnected") return "Come within reach of the others, and walk.";
  return "Walk a few metres, and in a curve.";
}

/** How a connection is, from a client's `state` event. */
export function connection({ state, what }) {
  switch (state) {
    case "open":
      return "";
    case "joining":
      return "Joining the room …";
    default:
      return what || "Not connected.";
  }
}
