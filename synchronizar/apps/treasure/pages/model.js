/** The game as it is told, in words and places. No elements, no drawing. */

export const THING = "treasure thing";
export const SCORE = "treasure score";
export const GHOST = "treasure ghost";
export const COLOURS = Object.freeze({ coin: "#f2b705", rusted: "#8a5a3c", obstacle: "#d94f30", start: "#3aa76d" });
export const NAMES = Object.freeze({ coin: "Coin", rusted: "Rusted coin", obstacle: "Obstacle", start: "Start" });

/** All objects of a kind. */
export function ofKind(client, kind) {
  return [...client.objects.values()].filter((object) => object.kind === kind);
}

/** What is told of the game, or null before anything is. */
export function scoreOf(client) {
  return client.objects.get(SCORE)?.data ?? null;
}

/** {head, line}: for who is called `name`, null for who only looks. */
export function words(score, name) {
  if (!score) return { head: "", line: "The game is being opened." };
  if (!score.found) {
    const by = score.by.slice(0, 4).join(", ");
    return { head: "Not found yet", line: by ? `The game lies by what was there then: ${by}. Two radios that stood still are enough.` : "The game cannot be found here." };
  }
  if (score.playing === null) return { head: `${score.things} things`, line: name === null ? "They are building." : "Hold the phone where something shall lie." };
  const mine = score.coins[name];
  const left = `${score.left} ${score.left === 1 ? "coin" : "coins"} left`;
  return { head: mine === undefined ? left : `You: ${mine} · ${left}`, line: mine === undefined && name !== null ? "Walk to the start." : "" };
}

/** Players with their coins, the best first: [[name, coins], ...]. */
export function standing(score) {
  return Object.entries(score?.coins ?? {}).sort(([, a], [, b]) => b - a);
}

/** Where a ghost is at `t` by the room's clock; null before it begins and after it has ended. */
export function ghostAt({ began, path }, t) {
  const s = t - began;
  if (!path.length || s < path[0][0] || s > path.at(-1)[0]) return null;
  const next = path.findIndex(([at]) => at >= s);
  const [a, b] = [path[Math.max(0, next - 1)], path[next]];
  const share = b[0] > a[0] ? (s - a[0]) / (b[0] - a[0]) : 1;
  return [1, 2, 3].map((i) => a[i] + share * (b[i] - a[i]));
}
