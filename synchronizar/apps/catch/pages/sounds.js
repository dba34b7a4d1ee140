/** What the game sounds like. */

export const THROW = [{ hz: 300, to: 900, s: 0.18, volume: 0.1, shape: "triangle" }];
export const CATCH = [
  { hz: 520, to: 780, s: 0.08 },
  { hz: 780, to: 1040, s: 0.14 },
];
export const DROP = [{ hz: 160, to: 60, s: 0.25, volume: 0.25 }];

/** The sound of a change from one phase to the next. */
export function soundOf(before, now) {
  if (now === "flies") return THROW;
  if (now === "held" && before === "flies") return CATCH;
  return now === "lies" ? DROP : null;
}
