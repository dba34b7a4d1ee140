/**
 * Axes. The common frame is z up, right-handed. WebXR, ARKit and ARCore are y up, right-handed, a device looks along
 * its own -z: x_z-up = -z, y_z-up = -x, z_z-up = y. Unity is left-handed: mirror its z first.
 */

/** [x, y, z] of y-up axes, in z-up axes. */
export function zUpFromYUp([x, y, z]) {
  return [-z, -x, y];
}

/** [x, y, z] of z-up axes, in y-up axes. */
export function yUpFromZUp([x, y, z]) {
  return [-y, z, -x];
}

/** A point of Unity's left-handed axes, in WebXR's; the same the other way round. */
export function mirrored([x, y, z]) {
  return [x, y, -z];
}

/** A quaternion x y z w of Unity's left-handed axes, in WebXR's; the same the other way round. */
export function mirroredQuaternion([x, y, z, w]) {
  return [-x, -y, z, w];
}

/** The product of two quaternions x y z w: the turn `b` and then the turn `a`. */
export function multiply([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

/** A vector turned by a quaternion x y z w. */
export function turned([x, y, z, w], v) {
  const [a, b, c] = multiply(multiply([x, y, z, w], [...v, 0]), [-x, -y, -z, w]);
  return [a, b, c];
}

/** A quaternion between two, `share` of the way from `a` to `b` along the shorter arc. */
export function between(a, b, share) {
  const sign = a.reduce((sum, v, i) => sum + v * b[i], 0) < 0 ? -1 : 1;
  const mixed = a.map((v, i) => v + share * (sign * b[i] - v));
  const length = Math.hypot(...mixed) || 1;
  return mixed.map((v) => v / length);
}

/** The turn x y z w from y-up axes into z-up ones; so what looks along -z, with y up, looks along x, with z up. */
export const Z_UP_FROM_Y_UP = Object.freeze([0.5, -0.5, -0.5, 0.5]);

/** The attitude x y z w, in a y-up device's own axes, of a thing that stands upright and whose own axes are z up. */
export const UPRIGHT_IN_Y_UP = Object.freeze([-0.5, 0.5, 0.5, 0.5]);

/** `common_from_user` of a told frame as {x, y, z, yaw, scale}, between z-up axes; null where there is none. */
export function placingOf(frame) {
  if (!frame || frame.matrix === null || frame.x === null) return null;
  return { x: frame.x, y: frame.y, z: frame.z, yaw: frame.yaw ?? 0, scale: frame.scale };
}

/**
 * Where the common frame lies in a device's own axes: 16 numbers, column by column, as three.js and WebGL take them.
 * `up`: which of the device's own axes points up.
 */
export function deviceFromCommon({ x, y, z, yaw, scale }, up = "y") {
  const own = up === "y" ? yUpFromZUp : (v) => v;
  const [c, s] = [Math.cos(yaw) / scale, Math.sin(yaw) / scale];
  const columns = [
    [c, -s, 0],
    [s, c, 0],
    [0, 0, 1 / scale],
  ];
  const origin = [-(c * x + s * y), s * x - c * y, -z / scale];
  return [...columns.flatMap((column) => [...own(column), 0]), ...own(origin), 1];
}

/** A point of the common frame, in a device's own axes. */
export function deviceFromPoint(placing, [x, y, z], up = "y") {
  const m = deviceFromCommon(placing, up);
  return [0, 1, 2].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]);
}

/** A point of a device's own axes, in the common frame. */
export function commonFromDevice(placing, point, up = "y") {
  const [px, py, pz] = (up === "y" ? zUpFromYUp(point) : point).map((v) => placing.scale * v);
  const [c, s] = [Math.cos(placing.yaw), Math.sin(placing.yaw)];
  return [placing.x + c * px - s * py, placing.y + s * px + c * py, placing.z + pz];
}

/** An attitude x y z w in a device's own axes, in the common frame; the body's own axes stay as they are. */
export function commonAttitude(placing, quat_xyzw, up = "y") {
  const own = up === "y" ? multiply(Z_UP_FROM_Y_UP, quat_xyzw) : quat_xyzw;
  return multiply([0, 0, Math.sin(placing.yaw / 2), Math.cos(placing.yaw / 2)], own);
}

/** Which way a device looks, rad in the plane of the common frame: along its own -z where it is y up, x where z up. */
export function heading(quat_xyzw, up) {
  const [x, y] = turned(quat_xyzw, up === "y" ? [0, 0, -1] : [1, 0, 0]);
  return Math.atan2(y, x);
}
