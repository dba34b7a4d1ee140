/** A name that faces whoever looks, drawn on a texture of its own. */

import { CanvasTexture, Sprite, SpriteMaterial, SRGBColorSpace } from "../vendor/three/three.module.min.js";

const HEIGHT_M = 0.09;
const PIXELS = 64;

export function label(words, colour) {
  const canvas = document.createElement("canvas");
  const paint = canvas.getContext("2d");
  const font = `600 ${0.6 * PIXELS}px system-ui, sans-serif`;
  paint.font = font;
  const width = Math.min(1024, Math.ceil(paint.measureText(words).width) + 1.25 * PIXELS);
  // A canvas that gets another size forgets all else.
  Object.assign(canvas, { width, height: PIXELS });
  paint.font = font;
  paint.fillStyle = "rgb(13 17 21 / 80%)";
  paint.beginPath();
  paint.roundRect(0, 0, canvas.width, PIXELS, PIXELS / 2);
  paint.fill();
  paint.fillStyle = colour;
  paint.beginPath();
  paint.arc(PIXELS / 2, PIXELS / 2, PIXELS / 6, 0, 2 * Math.PI);
  paint.fill();
  paint.fillStyle = "#ffffff";
  paint.textBaseline = "middle";
  paint.fillText(words, 0.8 * PIXELS, 0.54 * PIXELS, canvas.width - 1.25 * PIXELS);
  const map = new CanvasTexture(canvas);
  map.colorSpace = SRGBColorSpace;
  const sprite = new Sprite(new SpriteMaterial({ map, transparent: true, depthTest: false }));
  sprite.scale.set((HEIGHT_M * canvas.width) / PIXELS, HEIGHT_M, 1);
  sprite.renderOrder = 2;
  return sprite;
}

/** Frees what a label holds on the graphics card. */
export function dispose(sprite) {
  sprite.material.map.dispose();
  sprite.material.dispose();
}
