import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";

import { PAGES } from "./support.js";

const css = await readFile(new URL("style/base.css", PAGES), "utf8");
const [light, dark] = [...css.matchAll(/:root \{([^}]*)\}/g)].map(([, block]) =>
  Object.fromEntries([...block.matchAll(/--([\w-]+): (#[0-9a-f]{6});/g)].map(([, name, value]) => [name, value])),
);

/** WCAG 2: relative luminance, and contrast of two colours. */
function luminance(hex) {
  const [r, g, b] = [1, 3, 5].map((i) => {
    const v = parseInt(hex.slice(i, i + 2), 16) / 255;
    return v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

function contrast(a, b) {
  const [dim, bright] = [luminance(a), luminance(b)].sort((x, y) => x - y);
  return (bright + 0.05) / (dim + 0.05);
}

const TEXT = [
  ["ink", "ground"],
  ["ink", "page"],
  ["quiet", "ground"],
  ["quiet", "page"],
  ["quiet", "off-ground"],
  ["accent", "ground"],
  ["accent", "page"],
  ["on-accent", "accent"],
  ["good", "good-ground"],
  ["warn", "warn-ground"],
  ["bad", "bad-ground"],
  ["wait", "wait-ground"],
];
const SIGNS = ["short", "long", "fits", "accent"].map((name) => [name, "ground"]);

for (const [name, colours] of Object.entries({ light, dark })) {
  test(`words have a contrast of 4.5, and signs of 3: ${name}`, () => {
    for (const [pairs, least] of [
      [TEXT, 4.5],
      [SIGNS, 3],
    ]) {
      for (const [a, b] of pairs) {
        const found = contrast(colours[a], colours[b]);
        assert.ok(found >= least, `${a} on ${b}: ${found.toFixed(2)}`);
      }
    }
  });
}

test("devices' colours are seen on the map, light and dark", async () => {
  const { colourOf } = await import(new URL("view/colours.js", PAGES));
  for (let i = 0; i < 8; i++) {
    assert.ok(contrast(colourOf(i, false), light.ground) >= 3, `${i} light`);
    assert.ok(contrast(colourOf(i, true), dark.ground) >= 3, `${i} dark`);
  }
});

for (const page of ["index", "room", "phone"]) {
  test(`${page}: no script or style within the page, every label and reference leads somewhere`, async () => {
    const html = await readFile(new URL(`${page}.html`, PAGES), "utf8");
    assert.doesNotMatch(html, /<style|\sstyle=|\son\w+=|<script(?![^>]*\ssrc=)/);
    assert.match(html, /<html lang="en">/);
    const ids = new Set([...html.matchAll(/\sid="([^"]+)"/g)].map(([, id]) => id));
    for (const [, names] of html.matchAll(/\s(?:for|aria-labelledby|aria-describedby)="([^"]+)"/g)) {
      for (const id of names.split(" ")) assert.ok(ids.has(id), id);
    }
    for (const [, file] of html.matchAll(/(?:src|href)="pages\/([^"]+)"/g)) await readFile(new URL(file, PAGES));
    for (const [, input] of html.matchAll(/<input id="([^"]+)"/g)) assert.ok(html.includes(`<label for="${input}"`));
    for (const [image] of html.matchAll(/<img[^>]*>/g)) assert.match(image, /\salt=/);
  });
}
