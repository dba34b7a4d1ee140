/** Which way an arrow points for a cue's words: rad, to the left of straight on; null where words alone must do. */

const WAYS = [
  ["straight on", 0],
  ["ahead to your left", Math.PI / 4],
  ["ahead to your right", -Math.PI / 4],
  ["back to your left", (3 * Math.PI) / 4],
  ["back to your right", (-3 * Math.PI) / 4],
  ["to your left", Math.PI / 2],
  ["to your right", -Math.PI / 2],
];

/** A cue says the way by the walk ("to your left") while somebody walks, and by the others ("towards bob") otherwise. */
export function wayOf(cue) {
  if (!cue) return null;
  for (const [words, way] of WAYS) if (cue.endsWith(words)) return way;
  return /\d m back$/.test(cue) ? Math.PI : null;
}
