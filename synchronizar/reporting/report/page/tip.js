// Figures beside what the pointer or the keyboard is at.

const tip = document.getElementById("tip");

export function showTip(text, x, y) {
  if (tip.textContent !== text) tip.textContent = text;
  tip.hidden = false;
  const { width, height } = tip.getBoundingClientRect();
  const [right, bottom] = [document.documentElement.clientWidth, document.documentElement.clientHeight];
  const left = x + 16 + width > right ? x - 16 - width : x + 16;
  const top = y + 16 + height > bottom ? y - 16 - height : y + 16;
  tip.style.left = `${Math.min(Math.max(left, 4), Math.max(right - width - 4, 4))}px`;
  tip.style.top = `${Math.max(top, 4)}px`;
}

// At a place of a drawing, in its own units.
export function showTipIn(svg, text, x, y) {
  const box = svg.getBoundingClientRect();
  const { width, height } = svg.viewBox.baseVal;
  showTip(text, box.left + (x * box.width) / width, box.top + (y * box.height) / height);
}

export function hideTip() {
  tip.hidden = true;
}
