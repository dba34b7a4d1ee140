/** Small binary glTF files. */

/** One mesh of these places, y up, and what stands where. */
export function glb({ places, indices, nodes = [{ mesh: 0 }], mode, required, stride, uri }) {
  const step = stride ?? 12;
  const order = indices ? new Uint16Array(indices) : new Uint16Array(0);
  const length = step * places.length + 4 * Math.ceil(order.byteLength / 4);
  const body = new DataView(new ArrayBuffer(length));
  places.forEach((place, n) => place.forEach((v, i) => body.setFloat32(step * n + 4 * i, v, true)));
  order.forEach((v, n) => body.setUint16(step * places.length + 2 * n, v, true));
  const gltf = {
    asset: { version: "2.0" },
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes,
    meshes: [{ primitives: [{ attributes: { POSITION: 0 }, mode, ...(indices ? { indices: 1 } : {}) }] }],
    accessors: [
      { bufferView: 0, componentType: 5126, count: places.length, type: "VEC3" },
      { bufferView: 1, componentType: 5123, count: order.length, type: "SCALAR" },
    ],
    bufferViews: [
      { buffer: 0, byteLength: step * places.length, byteStride: stride },
      { buffer: 0, byteOffset: step * places.length, byteLength: order.byteLength },
    ],
    buffers: [{ byteLength: length, uri }],
    extensionsRequired: required,
  };
  const text = JSON.stringify(gltf);
  const json = new TextEncoder().encode(text.padEnd(4 * Math.ceil(text.length / 4)));
  const file = new DataView(new ArrayBuffer(28 + json.length + length));
  [0x46546c67, 2, file.byteLength, json.length, 0x4e4f534a].forEach((v, i) => file.setUint32(4 * i, v, true));
  const bytes = new Uint8Array(file.buffer);
  bytes.set(json, 20);
  file.setUint32(20 + json.length, length, true);
  file.setUint32(24 + json.length, 0x004e4942, true);
  bytes.set(new Uint8Array(body.buffer), 28 + json.length);
  return file.buffer;
}
