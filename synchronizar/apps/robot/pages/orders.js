/** Orders to robots, in words. No elements, no drawing. */

export const ORDER = "robot order";

/** All robots with what they do: [{robot, here, line}], by name. `name`: one's own, or null of who only looks. */
export function orders(client, name) {
  return [...client.objects.values()]
    .filter(({ kind }) => kind === ORDER)
    .map(({ data }) => {
      const state = client.frames?.users[data.robot]?.state;
      const here = client.member(data.robot)?.here ?? false;
      return { robot: data.robot, here, line: lineOf(data, here, state, name) };
    })
    .sort((a, b) => (a.robot < b.robot ? -1 : 1));
}

function lineOf({ robot, do: what, whom }, here, state, name) {
  if (!here) return `${robot} has left.`;
  if (state !== "registered") return `${robot} stands still: it does not know where it is.`;
  const you = whom === name ? "you" : whom;
  if (what === "mirror") return `${robot} is ${whom === name ? "your" : `${whom}'s`} mirror image.`;
  return what === "come" ? `${robot} comes to ${you}.` : `${robot} waits.`;
}
