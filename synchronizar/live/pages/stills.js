/** Still frames: small enough for a word, a few a second, to those alone whom one has allowed. */

/** Letters of a picture in one word: with the rest it stays below what a word may have. */
const MOST_LETTERS = 7000;
const QUALITIES = [0.7, 0.5, 0.35, 0.2];
const WIDTH = 256;
export const EVERY_S = 0.3;
/** s: an older picture is not what somebody sees now. */
export const OLD_S = 3;

/** A canvas as {jpeg, half, aspect}, as good as fits into a word; null where nothing does. */
export function still(canvas, half) {
  const small = document.createElement("canvas");
  for (const share of [1, 0.75, 0.5]) {
    small.width = Math.round(WIDTH * share);
    small.height = Math.round((small.width * canvas.height) / canvas.width);
    small.getContext("2d").drawImage(canvas, 0, 0, small.width, small.height);
    for (const quality of QUALITIES) {
      const jpeg = small.toDataURL("image/jpeg", quality).replace(/^data:image\/jpeg;base64,/, "");
      if (jpeg.length <= MOST_LETTERS) return { jpeg, half, aspect: canvas.width / canvas.height };
    }
  }
  return null;
}

/** The newest picture of each of those through whose eyes one looks. */
export class Gallery {
  #pictures = new Map();

  /** A word `eye`: resolves once its picture is read. What is no picture is left alone. */
  async hear(by, data, now) {
    const { jpeg, half, aspect } = data ?? {};
    if (typeof jpeg !== "string" || !(half > 0 && half < 10) || !(aspect > 0.1 && aspect < 10)) return;
    const image = new Image();
    image.src = `data:image/jpeg;base64,${jpeg}`;
    try {
      await image.decode();
    } catch {
      return;
    }
    this.#pictures.set(by, { image, half, aspect, at: now });
  }

  /** {image, half, aspect} of what somebody sees; null where none is new enough. */
  of(name, now) {
    const found = this.#pictures.get(name);
    return found && now - found.at < OLD_S ? found : null;
  }

  drop(name) {
    this.#pictures.delete(name);
  }
}
