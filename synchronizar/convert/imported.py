"""What an importer has read: poses and ranges by name, in m, s and quaternions x y z w."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.user import User


@dataclass
class RangeRows:
    """Ranges as they come, in columns that grow."""

    t: array[float] = field(default_factory=lambda: array("d"))
    a: list[str] = field(default_factory=list)
    b: list[str] = field(default_factory=list)
    distance: array[float] = field(default_factory=lambda: array("d"))
    sigma: array[float] = field(default_factory=lambda: array("d"))
    antenna_a: list[str] = field(default_factory=list)
    antenna_b: list[str] = field(default_factory=list)
    rx_power: array[float] = field(default_factory=lambda: array("d"))
    fp_power: array[float] = field(default_factory=lambda: array("d"))
    nlos: array[float] = field(default_factory=lambda: array("d"))

    def add(
        self,
        t: float,
        a: str,
        b: str,
        distance: float,
        *,
        sigma: float = np.nan,
        antenna_a: str = "",
        antenna_b: str = "",
        rx_power: float = np.nan,
        fp_power: float = np.nan,
        nlos: float = np.nan,
    ) -> None:
        """Append a range: t s, distance m, sigma m, powers dBm."""
        self.t.append(t)
        self.a.append(a)
        self.b.append(b)
        self.distance.append(distance)
        self.sigma.append(sigma)
        self.antenna_a.append(antenna_a)
        self.antenna_b.append(antenna_b)
        self.rx_power.append(rx_power)
        self.fp_power.append(fp_power)
        self.nlos.append(nlos)

    def rows(self, which: list[int]) -> RangeRows:
        """The ranges at these places."""
        picked = RangeRows()
        for name, column in vars(self).items():
            getattr(picked, name).extend(map(column.__getitem__, which))
        return picked

    def __len__(self) -> int:
        return len(self.t)


@dataclass
class Imported:
    """What a source holds."""

    tracks: dict[str, Array] = field(default_factory=dict)
    """Of each user, (n, 8) t x y z qx qy qz qw in any order, in the frame of its SLAM."""
    truth: dict[str, Array] = field(default_factory=dict)
    """The same in one frame for all."""
    ranges: RangeRows = field(default_factory=RangeRows)
    users: dict[str, User] = field(default_factory=dict)
    """What the source says of users; one that is not here has a track, z up, and nothing else is known of it."""
    notes: list[str] = field(default_factory=list)
    """What was guessed, assumed or left out, a sentence each."""

    def note(self, text: str) -> None:
        """Say it once."""
        if text not in self.notes:
            self.notes.append(text)


def merged(parts: Mapping[str, Imported]) -> Imported:
    """Several sources as one, each under the name of its file; the later one wins where a user has two tracks."""
    whole = Imported()
    for place, part in parts.items():
        for kind in ("tracks", "truth"):
            known, new = getattr(whole, kind), getattr(part, kind)
            for name in known.keys() & new.keys():
                whole.note(f"{place}: {name} had a track from another file, which this one replaces")
            known.update(new)
        whole.users.update(part.users)
        for column in vars(whole.ranges):
            getattr(whole.ranges, column).extend(getattr(part.ranges, column))
        for text in part.notes:
            whole.note(text if len(parts) == 1 else f"{place}: {text}")
    return whole
