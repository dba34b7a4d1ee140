/**
 * Poses as bytes, as in synchronizar/live/pose_wire.py: little-endian, the same over every transport.
 * Lengths m, times s, quaternions x y z w.
 */

const POSE = 1;
const POSES = 2;
const UP_BYTES = 56;
const HEAD_BYTES = 16;
const DOWN_BYTES = 48;

/** States by their number. */
export const STATES = Object.freeze(["registered", "ambiguous", "unobservable", "disconnected"]);

/**
 * Bytes of one pose of a device, in the axes of its own SLAM.
 * `user`: its index in `welcome.you`; `frame`: number of its SLAM frame; `sequence`: rises; `t`: by its own clock.
 */
export function encodePose({ user = 0, frame = 0, sequence, t, position, quat_xyzw }) {
  const bytes = new ArrayBuffer(UP_BYTES);
  const view = new DataView(bytes);
  view.setUint8(0, POSE);
  view.setUint8(1, frame);
  view.setUint16(2, user, true);
  view.setUint32(4, sequence >>> 0, true);
  view.setFloat64(8, t, true);
  for (let i = 0; i < 3; i++) view.setFloat64(16 + 8 * i, position[i], true);
  for (let i = 0; i < 4; i++) view.setFloat32(40 + 4 * i, quat_xyzw[i], true);
  return bytes;
}

/**
 * Everybody's poses in the common frame, z up: {sequence, t, poses: [{member, state, frame, age, position, quat_xyzw}]}.
 * Throws RangeError for other bytes.
 */
export function decodePoses(bytes) {
  const view = ArrayBuffer.isView(bytes)
    ? new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength)
    : new DataView(bytes);
  const count = view.byteLength >= HEAD_BYTES ? view.getUint16(2, true) : -1;
  if (count < 0 || view.getUint8(0) !== POSES || view.byteLength !== HEAD_BYTES + count * DOWN_BYTES) {
    throw new RangeError("no message of everybody's poses");
  }
  const floats = (get, from, size, n) => Array.from({ length: n }, (_, i) => view[get](from + size * i, true));
  const poses = [];
  for (let at = HEAD_BYTES; at < view.byteLength; at += DOWN_BYTES) {
    const state = STATES[view.getUint8(at + 2)];
    if (state === undefined) throw new RangeError("a state that there is not");
    poses.push({
      member: view.getUint16(at, true),
      state,
      frame: view.getUint8(at + 3),
      age: view.getFloat32(at + 4, true),
      position: floats("getFloat64", at + 8, 8, 3),
      quat_xyzw: floats("getFloat32", at + 32, 4, 4),
    });
  }
  return { sequence: view.getUint32(4, true), t: view.getFloat64(8, true), poses };
}
