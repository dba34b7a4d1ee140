// `node walk.js ADDRESS NAME PEER`: a phone that walks up and down, y up, and measures how far PEER is away.
//
// Run it twice, as alice who measures bob and as bob who measures alice. The walks are made up, so each knows where the
// other one truly is, and says at the end how far off the room has it.

import { RoomClient, monotonic, toOwn } from "./client.js";

const [POSES_HZ, RANGES_EVERY, SETTLED_S, GIVE_UP_S] = [30, 3, 6, 120];

// Where the two are, in m, in axes of a hall that neither knows.
const walks = {
  alice: (t) => [2 * Math.sin(0.5 * t), 1.4 + 0.05 * Math.sin(9 * t), -2 * Math.sin(0.8 * t)],
  bob: (t) => [3 * Math.cos(0.4 * t), 1.5 + 0.05 * Math.cos(8 * t), -2 * Math.sin(0.6 * t)],
};
// Where and with which heading each of them began its SLAM.
const begins = { alice: { at: [0, 1.4, 0], yaw: 0.4 }, bob: { at: [3, 1.5, 0], yaw: 2.1 } };

const [address, name, peer] = process.argv.slice(2);
if (!(name in walks && peer in walks && name !== peer)) {
  console.error("usage: node walk.js https://192.168.1.5:47180/#ABCD2345 alice bob");
  process.exit(2);
}

const client = await RoomClient.join(address, [{ name, up: "y" }]);
client.on("refused", ({ what }) => console.error(`refused: ${what}`));
client.on("close", () => process.exit(1));
client.on("frames", report);

let [steps, said, registeredAt] = [0, "", null];
const walking = setInterval(walk, 1000 / POSES_HZ);
setTimeout(() => process.exit(1), GIVE_UP_S * 1000).unref();

function walk() {
  const [t, hall] = [monotonic(), hallTime()];
  client.sendPose(name, t, inOwn(name, walks[name](hall)), [0, 0, 0, 1]);
  const here = client.members.some((member) => member.name === peer && (member.here ?? true));
  if (here && steps % RANGES_EVERY === 0) {
    const noise = 0.1 * (Math.random() + Math.random() + Math.random() - 1.5) * 2;
    client.sendRange(t, name, peer, distance(walks[name](hall), walks[peer](hall)) + noise);
  }
  steps += 1;
}

function report({ users }) {
  const [own, other] = [users[name], users[peer]];
  if (!own || !other) return;
  const sentence = `${peer}: ${other.state}${other.cue ? `, ${other.cue}` : ""}`;
  if (sentence !== said) console.log((said = sentence));
  if (own.state !== "registered" || other.state !== "registered") registeredAt = null;
  else registeredAt ??= monotonic();
  if (registeredAt === null || monotonic() - registeredAt < SETTLED_S || !client.poses.has(peer)) return;
  clearInterval(walking);
  const { position, age } = client.poses.get(peer);
  const mine = toOwn(own.matrix, position);
  const truth = inOwn(name, walks[peer](hallTime() - age));
  console.log(`${peer} in my own axes: ${mine.map((value) => value.toFixed(2)).join(" ")}`);
  console.log(`error: ${distance(mine, truth).toFixed(3)} m`);
  process.exit(0);
}

// s that both programs share, for the truth alone.
function hallTime() {
  return (Date.now() / 1000) % 10000;
}

function inOwn(user, point) {
  const { at, yaw } = begins[user];
  const [x, y, z] = point.map((value, i) => value - at[i]);
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return [c * x - s * z, y, s * x + c * z];
}

function distance(a, b) {
  return Math.hypot(...a.map((value, i) => value - b[i]));
}
