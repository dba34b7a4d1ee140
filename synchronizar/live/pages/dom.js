/** Elements. Whatever others have said goes in as text, never as markup. */

const SVG = "http://www.w3.org/2000/svg";

/** The element of the page with that id. */
export function byId(id) {
  return document.getElementById(id);
}

/** A new element: attributes, among them `text`, and children. */
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "text") made.textContent = value;
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null) made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

/** A filled shape as SVG, for colours that come from a program (a policy of no inline styles allows attributes only). */
export function swatch(colour, path = "M8 1a7 7 0 1 0 0 14A7 7 0 0 0 8 1z") {
  const svg = document.createElementNS(SVG, "svg");
  const shape = document.createElementNS(SVG, "path");
  for (const [name, value] of Object.entries({ viewBox: "0 0 16 16", class: "swatch", "aria-hidden": "true" })) {
    svg.setAttribute(name, value);
  }
  shape.setAttribute("d", path);
  shape.setAttribute("fill", colour);
  svg.append(shape);
  return svg;
}

/** Changes an element's text only where it is another one, so that nothing is read out twice. */
export function say(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

/**
 * Keeps one child of `parent` for each item, in their order: `make(item)` once, `update(child, item)` each time.
 * Children stay the same elements, so that focus and a reader's place are kept.
 */
export function keep(parent, items, keyOf, make, update) {
  const old = new Map([...parent.children].map((child) => [child.dataset.key, child]));
  let before = null;
  for (const item of items) {
    const key = String(keyOf(item));
    let child = old.get(key);
    old.delete(key);
    if (!child) {
      child = make(item);
      child.dataset.key = key;
    }
    update(child, item);
    const next = before ? before.nextSibling : parent.firstChild;
    if (next !== child) parent.insertBefore(child, next);
    before = child;
  }
  for (const child of old.values()) child.remove();
}
