"""What an importer has read: poses and ranges by name, in m, s and quaternions x y z w."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import compress
from typing import Any

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.data.user import User


def _numbers() -> array[float]:
    return array("d")


@dataclass
class RangeRows:
    """Ranges as they come, in columns that grow; what is not known is NaN, blank, or -1 (`source`)."""

    t: array[float] = field(default_factory=_numbers)
    a: list[str] = field(default_factory=list)
    b: list[str] = field(default_factory=list)
    distance: array[float] = field(default_factory=_numbers)
    sigma: array[float] = field(default_factory=_numbers)
    antenna_a: list[str] = field(default_factory=list)
    antenna_b: list[str] = field(default_factory=list)
    rx_power: array[float] = field(default_factory=_numbers)
    fp_power: array[float] = field(default_factory=_numbers)
    nlos: array[float] = field(default_factory=_numbers)
    source: array[float] = field(default_factory=_numbers)
    """Index in `data.ranges.SOURCES`."""

    def add(self, t: float, a: str, b: str, distance: float, **optional: float) -> None:
        """Append a range: t s, distance m; sigma m, powers dBm."""
        self.extend([t], [a], [b], [distance], **{name: [value] for name, value in optional.items()})

    def extend(
        self,
        t: Iterable[float],
        a: Sequence[str],
        b: Sequence[str],
        distance: Iterable[float],
        **optional: Iterable[float] | Iterable[str],
    ) -> None:
        """Append n ranges by columns, those of `optional` where they are known."""
        n = len(a)
        for name, values in {"t": t, "a": a, "b": b, "distance": distance}.items():
            getattr(self, name).extend(values)
        for name in _OPTIONAL.keys() | optional.keys():
            getattr(self, name).extend(optional.get(name, [_OPTIONAL[name]] * n))

    def rows(self, which: Mask) -> RangeRows:
        """The ranges that a mask (n,) picks."""
        return RangeRows(**{name: _picked(column, which) for name, column in vars(self).items()})

    def __len__(self) -> int:
        return len(self.t)


_OPTIONAL: Mapping[str, float | str] = {
    **dict.fromkeys(("sigma", "rx_power", "fp_power", "nlos"), np.nan),
    "antenna_a": "",
    "antenna_b": "",
    "source": -1.0,
}


def _picked(column: Any, which: Mask) -> Any:
    picked = compress(column, which.tolist())
    return list(picked) if isinstance(column, list) else array("d", picked)


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
    """Several sources as one, each under the name of its file.

    The later one's word counts where two have a track of one user, or a setting; what it does not say stays.
    """
    whole = Imported()
    for place, part in parts.items():
        for kind in ("tracks", "truth"):
            known, new = getattr(whole, kind), getattr(part, kind)
            for name in known.keys() & new.keys():
                whole.note(f"{place}: {name} had a track from another file, which this one replaces")
            known.update(new)
        for name, user in part.users.items():
            known = with_settings(whole.users.get(name, user), user)
            whole.users[name] = replace(known, up=user.up) if name in part.tracks else known
        for column in vars(whole.ranges):
            getattr(whole.ranges, column).extend(getattr(part.ranges, column))
        for text in part.notes:
            whole.note(text if len(parts) == 1 else f"{place}: {text}")
    return whole


def with_settings(known: User, new: User) -> User:
    """A user with those settings of `new` that differ from what a user has by itself."""
    plain = User(known.name)
    said = {f.name for f in fields(User) if f.name != "name" and getattr(new, f.name) != getattr(plain, f.name)}
    if "position" in said:
        said.add("position_sigma")
    return replace(known, **{name: getattr(new, name) for name in said})
