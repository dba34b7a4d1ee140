"""Colours, line styles and captions of users in the plots."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from matplotlib.colors import to_hex, to_rgb

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.reporting.answer import Answer
from synchronizar.reporting.uncertainty import axes_of, plane_covariance

# Paul Tol's muted scheme, distinct for the colour-blind, the strongest first.
PALETTE = ("#332288", "#44AA99", "#AA4499", "#999933", "#88CCEE", "#882255", "#117733", "#DDCC77", "#CC6677")
Dashes = Literal["-", "--", "-.", ":"]
DASHES: tuple[Dashes, ...] = ("-", "--", "-.", ":")
CONTRAST = 4.5
"""Of text to its background, at least (WCAG 2, AA)."""
STATIC = "#333333"
USED, REJECTED = "#888888", "#E3170A"
FAINT = 0.35
JUMP = "X"
"""The marker of a jump."""
MOST_POSES = 20_000
"""Poses drawn of a line: more look no different and take longer."""
LONGEST_NAME = 16
HEADING_UNKNOWN = 1.0
"""rad: 1 sigma of a yaw from which on it is called unknown."""


class Style(NamedTuple):
    """Colour and dashes of a user's lines."""

    colour: str
    dashes: Dashes

    @property
    def ink(self) -> str:
        """The colour, dark enough to be read on white."""
        rgb = np.array(to_rgb(self.colour))
        while 1.05 / (_luminance(rgb) + 0.05) < CONTRAST:
            rgb = 0.95 * rgb
        return to_hex(tuple(rgb))


def _luminance(rgb: Array) -> float:
    """Relative luminance as WCAG has it, 0 to 1."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def styles(answer: Answer) -> dict[str, Style]:
    """The styles of all users of an answer."""
    return styles_of({name: user.static for name, user in answer.registration.users.items()})


def styles_of(static: Mapping[str, bool]) -> dict[str, Style]:
    """The styles of users by name: static ones share one, others differ by colour, and from the tenth on by dashes."""
    out, walkers = {}, 0
    for name, stands in static.items():
        if stands:
            out[name] = Style(STATIC, "-")
        else:
            out[name] = Style(PALETTE[walkers % len(PALETTE)], DASHES[walkers // len(PALETTE) % len(DASHES)])
            walkers += 1
    return out


def few(n: int) -> slice:
    """Slice of n poses that leaves MOST_POSES at most, evenly spaced."""
    return slice(None, None, max(1, -(-n // MOST_POSES)))


def short(name: str) -> str:
    """The name, shortened to LONGEST_NAME characters."""
    return name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + "…"


def caption(answer: Answer, name: str) -> str:
    """`bob: registered ±0.04 m ±0.3°`: state, 1 sigma in the plane at the walk's end, 1 sigma of the heading."""
    registration = answer.registration
    user = registration.users[name]
    if name == registration.reference and not answer.corrects_slam:
        return f"{short(name)}: the reference"
    text = f"{short(name)}: {'the reference' if name == registration.reference else user.state}"
    if user.state is State.AMBIGUOUS:
        text += f" ({len(registration.alternatives)} fit)"
    if user.covariance is None:
        return text
    sigmas, _ = axes_of(plane_covariance(user, answer.tracks[name].position[-1]))
    text += f" ±{sigmas[0]:.2f} m"
    if user.static:
        return text
    yaw_sigma = float(np.sqrt(user.covariance[3, 3]))
    return text + (f" ±{np.degrees(yaw_sigma):.1f}°" if yaw_sigma < HEADING_UNKNOWN else ", yaw unknown")
