/** How high the floor is, in a device's own axes, by what it sees below itself. No elements, no drawing. */

/** m: points of one height. */
const BIN_M = 0.04;
/** Of a level surface among the lowest: points at least, and their share of all that lie so deep. */
const [LEAST, SHARE] = [60, 0.1];
/** m below the device: what is higher may be a table. */
const BELOW_M = 0.9;

export class Floor {
  #bins = new Map();
  #all = 0;
  #sums = new Map();

  /** A point of a surface and the device lie so high (m). */
  add(height, device) {
    if (height > device - BELOW_M) return;
    const bin = Math.floor(height / BIN_M);
    this.#bins.set(bin, (this.#bins.get(bin) ?? 0) + 1);
    this.#sums.set(bin, (this.#sums.get(bin) ?? 0) + height);
    this.#all += 1;
  }

  /** m: of the lowest level surface; null while none was seen. */
  get height() {
    const enough = Math.max(LEAST, SHARE * this.#all);
    for (const bin of [...this.#bins.keys()].sort((a, b) => a - b)) {
      const [count, next] = [this.#bins.get(bin), this.#bins.get(bin + 1) ?? 0];
      if (count + next >= enough) return (this.#sums.get(bin) + (this.#sums.get(bin + 1) ?? 0)) / (count + next);
    }
    return null;
  }

  /** The device's own axes have begun anew. */
  clear() {
    this.#bins.clear();
    this.#sums.clear();
    this.#all = 0;
  }
}
