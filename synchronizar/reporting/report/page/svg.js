// What all drawings share: elements, axes, dashes.

const DASHES = ["", "7 4", "2 3"];

export function element(name, attributes = {}, parent = null) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [of, value] of Object.entries(attributes)) made.setAttribute(of, value);
  parent?.append(made);
  return made;
}

export function writing(parent, text, attributes) {
  element("text", attributes, parent).textContent = text;
}

export const colourOf = (user) => `var(--u${user.look.colour})`;
export const dashesOf = (user) => DASHES[user.look.dashes];

export function lineOf(user, attributes, parent) {
  const line = element("path", { "stroke-dasharray": dashesOf(user), ...attributes }, parent);
  line.style.stroke = colourOf(user);
  return line;
}

// Round numbers from low to high, `most` of them or fewer.
export function ticks(low, high, most) {
  const rough = (high - low) / Math.max(most, 1);
  if (!(rough > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((times) => times * power >= rough);
  const out = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * step; n += 1) out.push(n * step);
  return out;
}

export const plain = (x) => String(Number(x.toPrecision(6))).replace("-", "−");

// The size that a drawing has on the page now, and an empty drawing of it.
export function cleared(svg, height) {
  const width = Math.max(240, svg.clientWidth || svg.parentElement.clientWidth || 900);
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.style.height = "auto";
  svg.replaceChildren();
  return width;
}

// Where a pointer is, in a drawing's own units.
export function pointIn(svg, event) {
  const box = svg.getBoundingClientRect();
  const { width, height } = svg.viewBox.baseVal;
  return [((event.clientX - box.left) * width) / box.width, ((event.clientY - box.top) * height) / box.height];
}

// Moves the line of the moment that is looked at, which stands above a drawing down to a height in its own units.
export function moveCursor(svg, x, height) {
  const { width, height: whole } = svg.viewBox.baseVal;
  const style = svg.parentElement.querySelector(".cursor").style;
  style.left = `${(100 * x) / width}%`;
  style.height = `${(100 * height) / whole}%`;
}

export function timeAxis(svg, x, end, top, bottom, most) {
  for (const t of ticks(0, end, most)) {
    element("path", { class: "grid", d: `M${x(t)} ${top}V${bottom}` }, svg);
    const anchor = t > 0.97 * end ? "end" : "middle";
    writing(svg, `${plain(t)} s`, { x: x(t) + (anchor === "end" ? 6 : 0), y: bottom + 15, "text-anchor": anchor });
  }
}
