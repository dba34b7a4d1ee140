/** Colours that people with any kind of colour vision tell apart (Okabe and Ito), lighter or darker by the page's. */

const LIGHT = ["#0072b2", "#d55e00", "#007a5a", "#a8457f", "#b27d00", "#2b93c9", "#5b5b5b", "#8f7a00"];
const DARK = ["#56b4e9", "#ff8c42", "#2fd0a2", "#ea9bc8", "#f5b92e", "#8fd0f5", "#c8c8c8", "#f0e442"];

const dark = globalThis.matchMedia?.("(prefers-color-scheme: dark)");

/** Whether the page is dark. */
export function isDark() {
  return dark?.matches ?? false;
}

/** Calls back when the page becomes dark or light. */
export function onDarkChange(then) {
  dark?.addEventListener("change", then);
}

/** The colour of a member, by its index. */
export function colourOf(index, onDark = isDark()) {
  const colours = onDark ? DARK : LIGHT;
  return colours[index % colours.length];
}

/** m: a residual of this size or more has the full colour. */
export const FULL_RESIDUAL = 0.5;

/** A range's colour: grey where it fits, towards blue where it is too short, towards orange where it is too long. */
export function residualColour(residual, onDark = isDark()) {
  const grey = onDark ? [150, 158, 168] : [130, 138, 148];
  if (residual === null) return `rgb(${grey.join(" ")})`;
  const full = residual < 0 ? (onDark ? [86, 180, 233] : [0, 94, 170]) : onDark ? [255, 140, 66] : [213, 94, 0];
  const share = Math.min(1, Math.abs(residual) / FULL_RESIDUAL);
  return `rgb(${grey.map((v, i) => Math.round(v + share * (full[i] - v))).join(" ")})`;
}
