"""A recording out of what importers have read: names as asked, what no recording can hold left out and said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.convert.asked import Asked
from synchronizar.convert.imported import Imported, RangeRows, with_settings
from synchronizar.convert.mapping import Radio, mapped
from synchronizar.convert.stillness import moves
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.io.ranges_csv import antenna_indices
from synchronizar.io.text import MAX_LENGTH, MAX_PLACE, MAX_STAMP, MIN_SIGMA, is_name, quoted
from synchronizar.io.tum import track_of_rows

NAMED = 12
"""Names in a message, at most."""


class Assembled(NamedTuple):
    """What is to be written."""

    recording: Recording
    truth: dict[str, Track]
    notes: list[str]
    """What was guessed, assumed or left out, a sentence each."""


def assemble(place: str, imported: Imported, asked: Asked) -> Assembled:
    """The recording of what was read.

    Raises InputError, which names `place`, where nothing is left or a name cannot be a user's.
    """
    _carry(imported, mapped(asked).radios)
    _rename(place, imported, asked)
    tracks = {name: rows for name, rows in imported.tracks.items() if name not in asked.static}
    usable = {name: _usable(imported, f"{name}'s track", rows) for name, rows in tracks.items()}
    tracks = {name: rows for name, rows in usable.items() if len(rows)}
    truth = {name: _usable(imported, f"{name}'s truth", rows) for name, rows in imported.truth.items()}
    made = {name: track_of_rows(rows, imported.users.get(name, User(name)).up) for name, rows in tracks.items()}
    users = _users(imported, made, asked)
    if not users:
        raise InputError(place, "holds neither a pose nor a range that can be used")
    in_order = tuple(users[name] for name in sorted(users))
    of_users = {name: rows for name, rows in truth.items() if len(rows) and name in users}
    if strangers := sorted(name for name in truth if name not in users):
        imported.note(f"the truth of {listed(strangers)}, with neither a track nor ranges, is left out")
    true = {name: track_of_rows(rows, users[name].up) for name, rows in of_users.items()}
    recording = Recording(in_order, made, _ranges(place, imported, in_order))
    return Assembled(recording, true, imported.notes)


def _carry(imported: Imported, radios: Mapping[str, Radio]) -> None:
    """Radios as the map has them: their ranges become those of the devices that carry them."""
    ranges = imported.ranges
    for names, antennas in ((ranges.a, ranges.antenna_a), (ranges.b, ranges.antenna_b)):
        for k, name in enumerate(names):
            if name in radios:
                names[k] = radios[name].user
                antennas[k] = radios[name].antenna or antennas[k]
    for radio in radios.values():
        user = imported.users.get(radio.user, User(radio.user))
        if radio.position is not None:
            sigma = radio.position_sigma
            imported.users[radio.user] = replace(user, static=True, position=radio.position, position_sigma=sigma)
        if radio.lever is not None:
            levers = {**user.antennas, radio.antenna: radio.lever}
            imported.users[radio.user] = replace(user, antennas=levers)


def _rename(place: str, imported: Imported, asked: Asked) -> None:
    """Names as asked, everywhere; what is not wanted is dropped."""
    ranges = imported.ranges
    known = {*imported.tracks, *imported.truth, *imported.users, *ranges.a, *ranges.b}
    renamed = dict(asked.renamed)
    new = {name: renamed.get(name, name) for name in known}
    for option, names in (("--rename", renamed), ("--without", asked.left_out), ("--static", asked.static)):
        if unknown := [name for name in names if name not in {*known, *new.values()}]:
            raise InputError(option, f"{place} has no {quoted(unknown[0])}: there are {listed(sorted(known))}")
    wanted = {name: of for name, of in new.items() if not {name, of} & set(asked.left_out)}
    for name in sorted(wanted.values()):
        if not is_name(name):
            raise InputError(place, f"{quoted(name)} cannot be a user's name: give it another by --rename")
    imported.tracks = _joined(place, imported.tracks, wanted)
    imported.truth = _joined(place, imported.truth, wanted)
    users: dict[str, User] = {}
    for name, user in imported.users.items():
        if name in wanted:
            users[wanted[name]] = with_settings(users.get(wanted[name], User(wanted[name])), user)
    imported.users = users
    if wanted != {name: name for name in known}:
        numbered = _numbered(ranges)
        imported.ranges = ranges.rows(numbered.between(np.array([name in wanted for name in numbered.names], bool)))
        imported.ranges.a = [wanted[name] for name in imported.ranges.a]
        imported.ranges.b = [wanted[name] for name in imported.ranges.b]


def _joined(place: str, tracks: dict[str, Array], wanted: Mapping[str, str]) -> dict[str, Array]:
    joined: dict[str, Array] = {}
    for name, rows in tracks.items():
        if name in wanted:
            if wanted[name] in joined:
                raise InputError("--rename", f"{place} has two tracks that would both be {quoted(wanted[name])}'s")
            joined[wanted[name]] = rows
    return joined


def _usable(imported: Imported, whose: str, rows: Array) -> Array:
    """The poses that a track can hold."""
    good = np.isfinite(rows).all(axis=1) & (np.abs(rows[:, 0]) <= MAX_STAMP) & rows[:, 4:].any(axis=1)
    good &= (np.abs(rows[:, 1:4]) <= MAX_PLACE).all(axis=1)
    if not good.all():
        imported.note(f"{(~good).sum()} of {len(rows)} poses of {whose} are no poses and left out")
    return rows[good]


def _users(imported: Imported, tracks: Mapping[str, Track], asked: Asked) -> dict[str, User]:
    """Everybody: who has a track, and who has ranges and none, which can only be a radio that stands still."""
    users = {name: _moving(imported.users.get(name, User(name))) for name in tracks}
    numbered = _numbered(imported.ranges)
    t, distance = np.array(imported.ranges.t), np.array(imported.ranges.distance)
    still, moving = [], []
    for name in sorted({*numbered.names, *asked.static} - users.keys()):
        known = imported.users.get(name, User(name))
        if not known.static and name not in asked.static:
            partners = numbered.partners(name)
            if moves({of: (tracks[of], t[rows], distance[rows]) for of, rows in partners.items() if of in tracks}):
                moving.append(name)
                continue
            still.append(name)
        users[name] = replace(known, static=True, antennas={})
    if still:
        imported.note(
            f"{listed(still)}: ranges and no track, so taken to stand still (--rename NAME=DEVICE says whose it is,"
            " --without NAME leaves one out that moves)"
        )
    if moving:
        imported.note(
            f"{listed(moving)}: ranges and no track, and no place in any device's frame explains them: it moves, and is"
            " left out (--static NAME keeps one that stands still)"
        )
        imported.ranges = imported.ranges.rows(
            numbered.between(np.array([name not in moving for name in numbered.names], bool))
        )
    return users


def _moving(user: User) -> User:
    return replace(user, static=False, position=None, position_sigma=None)


class _Numbered(NamedTuple):
    """Who n ranges are between, by numbers."""

    names: list[str]
    """Of k devices, sorted."""
    a: Indices
    """(n,) index in `names`."""
    b: Indices

    def between(self, wanted: Mask) -> Mask:
        """(n,): which ranges are between two of those whom a mask (k,) picks."""
        return np.asarray(wanted[self.a] & wanted[self.b])

    def partners(self, name: str) -> dict[str, Indices]:
        """Which ranges a device has with each other one."""
        own = self.names.index(name) if name in self.names else -1
        mine = np.flatnonzero((self.a == own) | (self.b == own))
        other = np.where(self.a[mine] == own, self.b[mine], self.a[mine])
        return {self.names[k]: mine[other == k] for k in np.unique(other).tolist()}


def _numbered(ranges: RangeRows) -> _Numbered:
    names = sorted({*ranges.a, *ranges.b})
    index_of = {name: k for k, name in enumerate(names)}
    a, b = (np.fromiter(map(index_of.__getitem__, end), np.int32, len(end)) for end in (ranges.a, ranges.b))
    return _Numbered(names, a, b)


def _ranges(place: str, imported: Imported, users: tuple[User, ...]) -> Ranges:
    """The ranges in the order of time, without those that cannot be one."""
    rows = imported.ranges
    numbered, index_of = _numbered(rows), {user.name: k for k, user in enumerate(users)}
    number = np.array([index_of[name] for name in numbered.names], dtype=np.int32)
    a, b, t = number[numbered.a], number[numbered.b], np.array(rows.t)
    good = (np.abs(t) <= MAX_STAMP) & (a != b)
    if not good.all():
        imported.note(
            f"{(~good).sum()} of {len(t)} ranges have no stamp in seconds, or one device twice, and are left out"
        )
    kept = np.flatnonzero(good)[np.argsort(t[good], kind="stable")]
    numbers = {name: np.array(getattr(rows, name))[kept] for name in ("sigma", "rx_power", "fp_power", "nlos")}
    numbers["sigma"] = _within(numbers["sigma"], MIN_SIGMA, MAX_LENGTH)
    antennas: dict[str, Indices] = {"source": np.array(rows.source)[kept].astype(np.int32)}
    for name, who in (("antenna_a", a[kept]), ("antenna_b", b[kept])):
        named = getattr(rows, name)
        antennas[name], unknown = antenna_indices(users, who, [named[k] for k in kept.tolist()])
        if unknown is not None:
            user = users[int(who[unknown])]
            raise InputError(
                place, f"a range of {user.name} says no antenna that it has: there are {listed(list(user.antennas))}"
            )
    return Ranges.of(t[kept], a[kept], b[kept], np.array(rows.distance)[kept], **numbers, **antennas)


def _within(values: Array, smallest: float, largest: float) -> Array:
    """(n,): NaN where a value is not between the two."""
    with np.errstate(invalid="ignore"):
        return np.where((values >= smallest) & (values <= largest), values, np.nan)


def listed(names: Sequence[str]) -> str:
    """Names for a message; a dozen at most."""
    shown = ", ".join(names[:NAMED])
    return shown if len(names) <= NAMED else f"{shown} and {len(names) - NAMED} more"
