/** How others come in: the address, its QR code, and the room's code. */

import { say } from "../dom.js";
import { spelled } from "../visit.js";

/** Fills the card; the room's code goes in a body, never in an address. */
export async function fillJoinCard({ image, address, code: codeText }, server, code) {
  say(codeText, spelled(code));
  say(address, server);
  try {
    const response = await fetch(new URL("api/qr", server), {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ room: code }),
    });
    if (!response.ok) return;
    const { join, svg } = await response.json();
    // Inside a page an SVG needs no namespace, as a picture of its own it does.
    const picture = svg.includes("xmlns=") ? svg : svg.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"');
    image.src = URL.createObjectURL(new Blob([picture], { type: "image/svg+xml" }));
    const [where] = join.split("#");
    image.alt = `QR code of ${where}`;
    image.hidden = false;
    say(address, where);
  } catch {
    // Without the picture there is still the address.
  }
}
