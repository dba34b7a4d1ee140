"""Which colour and line everybody has, and how they are called."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np

from synchronizar.data.registration import State
from synchronizar.reporting.plots.answer import Answer
from synchronizar.reporting.plots.uncertainty import axes_of, plane_covariance

# Paul Tol's muted scheme, which the colour-blind can tell apart, the strongest first.
PALETTE = ("#332288", "#44AA99", "#AA4499", "#999933", "#88CCEE", "#882255", "#117733", "#DDCC77", "#CC6677")
Dashes = Literal["-", "--", "-.", ":"]
DASHES: tuple[Dashes, ...] = ("-", "--", "-.", ":")
STATIC = "#333333"
USED, REJECTED = "#888888", "#E3170A"
FAINT = 0.35
JUMP = "X"
"""The marker of a jump."""
MOST_POSES = 20_000
"""A line through more places looks no different and takes long to draw."""
LONGEST_NAME = 16
HEADING_UNKNOWN = 1.0
"""rad, 1 sigma."""


class Style(NamedTuple):
    """How a user is drawn."""

    colour: str
    dashes: Dashes


def styles(answer: Answer) -> dict[str, Style]:
    """Of all users of an answer."""
    return styles_of({name: user.static for name, user in answer.registration.users.items()})


def styles_of(static: Mapping[str, bool]) -> dict[str, Style]:
    """By who stands still: those are all alike; others differ by colour, and from the tenth on by dashes."""
    out, walkers = {}, 0
    for name, stands in static.items():
        if stands:
            out[name] = Style(STATIC, "-")
        else:
            out[name] = Style(PALETTE[walkers % len(PALETTE)], DASHES[walkers // len(PALETTE) % len(DASHES)])
            walkers += 1
    return out


def few(n: int) -> slice:
    """Of n poses in the order of time, evenly chosen ones: as many as a line needs."""
    return slice(None, None, max(1, -(-n // MOST_POSES)))


def short(name: str) -> str:
    """A name that fits."""
    return name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + "…"


def caption(answer: Answer, name: str) -> str:
    """`bob: registered ±0.04 m ±0.3°`: 1 sigma in the plane, where its walk ends, and of its heading."""
    registration = answer.registration
    user = registration.users[name]
    if name == registration.reference and not answer.corrects_slam:
        return f"{short(name)}: the reference"
    said = f"{short(name)}: {'the reference' if name == registration.reference else user.state}"
    if user.state is State.AMBIGUOUS:
        said += f" ({len(registration.alternatives)} fit)"
    if user.covariance is None:
        return said
    sigmas, _ = axes_of(plane_covariance(user, answer.tracks[name].position[-1]))
    said += f" ±{sigmas[0]:.2f} m"
    if user.static:
        return said
    yaw_sigma = float(np.sqrt(user.covariance[3, 3]))
    return said + (f" ±{np.degrees(yaw_sigma):.1f}°" if yaw_sigma < HEADING_UNKNOWN else ", yaw unknown")
