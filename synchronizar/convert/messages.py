"""From messages to poses and ranges, whatever file they stand in: a bag or an MCAP file."""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.asked import LENGTH_UNITS, Asked
from synchronizar.convert.assembling import listed
from synchronizar.convert.fields import Topic
from synchronizar.convert.guess import PoseRole, RangeRole, Roles, field_list, preferred, roles_of
from synchronizar.convert.imported import Imported
from synchronizar.convert.mapping import Mapped, mapped
from synchronizar.convert.names import matched
from synchronizar.convert.radios import carriers
from synchronizar.convert.reading import PoseReader, RangeReader, likely_unit
from synchronizar.convert.track_file import add_track, add_truth
from synchronizar.convert.transforms import Transforms
from synchronizar.errors import InputError
from synchronizar.progress import Progress

_CLOCKS_AGREE = 1.0
"""s: stamps that differ more from when they were logged than others' do are of another clock."""
_STEP = 5000


@contextmanager
def broken(path: Path, remedy: str) -> Iterator[None]:
    """Whatever the libraries that decode a file raise where it is broken, as an InputError that names it."""
    try:
        yield
    except (InputError, ModuleNotFoundError, MemoryError):
        raise
    except Exception as error:
        fault = str(error).rstrip(".") or type(error).__name__
        raise InputError(path, f"is broken: {fault} ({remedy})") from error


class Messages(Protocol):
    """An open file of messages."""

    topics: list[Topic]

    def read(self, names: Collection[str]) -> Iterator[tuple[str, float, Any, float]]:
        """Messages of some topics in the order of the file: topic, when it was logged (s), message, share read."""


def listing(messages: Messages, asked: Asked, place: str) -> list[str]:
    """What topics there are, and what is guessed of each."""
    roles = roles_of(messages.topics, mapped(asked), _first_of(messages), place)
    said = {role.topic.name: f"{'truth' if role.is_truth else 'poses'} of {role.user}" for role in roles.poses}
    said |= {topic.name: "transforms" for topic in roles.transforms}
    said |= {role.topic.name: _told(role) for role in roles.ranges}
    lines = []
    for topic in sorted(messages.topics, key=lambda topic: topic.name):
        lines.append(f"{topic.name}  {topic.type}  {topic.count}: {said.get(topic.name, 'not read')}")
        if topic.name not in said and topic.count:
            reason = roles.rest.get(topic.name, "")
            if reason and reason != topic.type:
                lines.append(f"    {reason}")
            if topic.fields and not topic.type.startswith(("sensor_msgs/", "visualization_msgs/")):
                lines.append(f"    fields: {field_list(topic.fields)}")
    return lines


def _told(role: RangeRole) -> str:
    a, b = (end.removeprefix("=") if end.startswith("=") else f"[{end}]" for end in (role.a, role.b))
    b = "[index]" if role.b == "#" else b
    return f"ranges of {a} and {b} in {role.value} ({role.unit or 'unit by size'})"


def imported_of(messages: Messages, asked: Asked, place: str, progress: Progress) -> Imported:
    """Tracks, truth and ranges of all topics that were named or guessed. Raises InputError where there are none."""
    said = mapped(asked)
    roles = roles_of(messages.topics, said, _first_of(messages), place)
    imported = Imported()
    chosen = _chosen(roles, imported)
    takers: dict[str, _Poses | _Ranges | _Frames] = {role.topic.name: _Poses(role) for role in chosen}
    takers |= {role.topic.name: _Ranges(role) for role in roles.ranges}
    frames = Transforms()
    takers |= {topic.name: _Frames(topic, frames) for topic in roles.transforms}
    if not takers:
        raise InputError(place, "has no topic of poses, transforms or ranges that is known: --list shows what it has")
    for count, (name, logged, message, share) in enumerate(messages.read(takers)):
        takers[name].take(logged, message)
        if count % _STEP == 0:
            progress(share)
    progress(1.0)
    clock = _Clock([t for t in takers.values() if isinstance(t, _Poses | _Ranges)], asked, imported)
    for taker in takers.values():
        if isinstance(taker, _Poses):
            rows = taker.rows(clock.stamps(taker))
            add = add_truth if taker.role.is_truth else add_track
            add(imported, taker.role.user, rows, asked)
    _add_frames(imported, frames, asked)
    for taker in takers.values():
        if isinstance(taker, _Ranges):
            taker.add_to(imported, clock.stamps(taker), asked)
    _truth_alone(imported)
    _name_radios(imported, said, asked, [t for t in takers.values() if isinstance(t, _Ranges)])
    _tell(imported, roles)
    return imported


def _first_of(messages: Messages) -> Callable[[Topic], Any]:
    def first(topic: Topic) -> Any:
        return next((message for _, _, message, _ in messages.read([topic.name])), None)

    return first


def _chosen(roles: Roles, imported: Imported) -> list[PoseRole]:
    """One topic of poses for each device, and one of its truth."""
    by_user: dict[tuple[str, bool], list[PoseRole]] = defaultdict(list)
    for role in roles.poses:
        by_user[role.user, role.is_truth].append(role)
    chosen = []
    for (user, is_truth), several in sorted(by_user.items()):
        best = preferred(several)
        what = "truth" if is_truth else "track"
        others = [role.topic.name for role in several if role is not best]
        instead = f" (and not {listed(others)})" if others else ""
        imported.note(f"{best.topic.name} is {user}'s {what}{instead}")
        chosen.append(best)
    return chosen


class _Poses:
    """The poses of a topic."""

    def __init__(self, role: PoseRole) -> None:
        self.role = role
        self.logged, self.own, self._poses = array("d"), array("d"), array("d")
        self._reader = PoseReader(role)

    def take(self, logged: float, message: Any) -> None:
        self._poses.extend(self._reader.pose(message))
        self.logged.append(logged)
        self.own.append(self._reader.stamp(message))

    def rows(self, t: Array) -> Array:
        """(n, 8) poses at these stamps."""
        return np.column_stack([t, np.array(self._poses).reshape(-1, 7)])


class _Ranges:
    """The ranges of a topic."""

    def __init__(self, role: RangeRole) -> None:
        self.role = role
        self.logged, self.own = array("d"), array("d")
        self.distance = array("d")
        self.a: list[str] = []
        self.b: list[str] = []
        self.optional: dict[str, list[Any]] = {name: [] for name in role.optional}
        self._reader = RangeReader(role)

    def take(self, logged: float, message: Any) -> None:
        own = self._reader.stamp(message)
        for distance, a, b, optional in self._reader.ranges(message):
            self.logged.append(logged)
            self.own.append(own)
            self.distance.append(distance)
            self.a.append(a)
            self.b.append(b)
            for name, value in optional.items():
                self.optional[name].append(value)

    def add_to(self, imported: Imported, t: Array, asked: Asked) -> None:
        """Add them, in metres."""
        distance = np.array(self.distance) * self._metres(imported, asked)
        numbers = {name: np.array(self.optional.get(name, [])) for name in ("sigma", "rx_power", "fp_power", "nlos")}
        ranges = imported.ranges
        n = len(distance)
        ranges.t.extend(t.tolist())
        ranges.distance.extend(distance.tolist())
        ranges.a.extend(self.a)
        ranges.b.extend(self.b)
        for name, of in numbers.items():
            getattr(ranges, name).extend(of.astype(float).tolist() if len(of) == n else [np.nan] * n)
        for name in ("antenna_a", "antenna_b"):
            getattr(ranges, name).extend(map(str, self.optional.get(name, [""] * n)))
        if self._reader.empty:
            what = f"{self._reader.empty} distances of 0 in {self.role.topic.name}"
            imported.note(f"{what} are no measurements and left out")

    def _metres(self, imported: Imported, asked: Asked) -> float:
        name, value = self.role.topic.name, self.role.value
        if asked.range_unit is not None:
            return LENGTH_UNITS[asked.range_unit]
        unit = self.role.unit
        if unit is None:
            unit, why = likely_unit(self.role, self.distance)
            imported.note(f"{value} in {name} is taken to be in {unit} ({why}; --range-unit says otherwise)")
        return LENGTH_UNITS[unit]


class _Frames:
    """Transforms of a topic."""

    def __init__(self, topic: Topic, frames: Transforms) -> None:
        self._frames, self._is_static = frames, topic.name.rstrip("/").endswith("tf_static")
        self._space = topic.name.strip("/").rpartition("/")[0]
        self._is_list = topic.has("transforms")

    def take(self, logged: float, message: Any) -> None:
        several = (
            (message["transforms"] if isinstance(message, Mapping) else message.transforms)
            if self._is_list
            else [message]
        )
        for transform in several:
            self._frames.add(self._space, logged, transform, self._is_static)


class _Clock:
    """Which stamps count. One clock for all where that can be: messages' own, if they agree."""

    def __init__(self, takers: list[_Poses | _Ranges], asked: Asked, imported: Imported) -> None:
        self._by_log = asked.stamps == "log"
        self._offset: dict[int, float] = {}
        usable = {id(t): np.array(t.own) - np.array(t.logged) for t in takers if len(t.own)}
        usable = {k: d for k, d in usable.items() if np.isfinite(d).all()}
        medians = {k: float(np.median(d)) for k, d in usable.items()}
        zero = {id(t) for t in takers if len(t.own) and not np.any(t.own)}
        weights = {id(t): len(t.own) for t in takers}
        candidates = sorted((m, weights[k]) for k, m in medians.items() if k not in zero)
        self.common = 0.0
        if candidates and not self._by_log:
            support = [sum(w for m, w in candidates if abs(m - of) < _CLOCKS_AGREE) for of, _ in candidates]
            self.common = candidates[int(np.argmax(support))][0]
        self._own = {k for k, m in medians.items() if k not in zero and abs(m - self.common) < _CLOCKS_AGREE}
        if self._by_log or asked.stamps == "header":
            self._own = set() if self._by_log else set(medians)
            return
        if abs(self.common) > _CLOCKS_AGREE and self._own:
            imported.note(
                f"messages' own stamps lie {self.common:.6g} s from when they were logged: their own are taken"
            )
        strange = [t.role.topic.name for t in takers if len(t.own) and id(t) not in self._own]
        if strange and self._own:
            imported.note(
                f"{listed(sorted(strange))}: no stamps of their own, or of another clock than the rest's, so they have"
                " the time at which they were logged (--stamps header takes their own)"
            )
        elif strange:
            self.common = 0.0
            imported.note("messages have no stamps of their own: they have the time at which they were logged")

    def stamps(self, taker: _Poses | _Ranges) -> Array:
        """(n,) s."""
        if id(taker) in self._own:
            return np.array(taker.own)
        return np.array(taker.logged) + (0.0 if self._by_log else self.common)


def _add_frames(imported: Imported, frames: Transforms, asked: Asked) -> None:
    """Tracks out of transforms, of devices that have none."""
    for track in frames.tracks():
        user = track.user or "robot"
        alone = user == "robot" and len(imported.tracks) == 1
        if user in imported.tracks or alone:
            continue
        imported.note(f"{track.child} in {track.parent}, of the transforms, is {user}'s track")
        add_track(imported, user, track.rows, asked)


def _truth_alone(imported: Imported) -> None:
    """Where nobody has a track of its own, truth is both."""
    named = matched(imported.truth.keys(), imported.tracks.keys())
    imported.truth = {named.get(name, name): rows for name, rows in imported.truth.items()}
    alone = sorted(imported.truth.keys() - imported.tracks.keys())
    if alone and not imported.tracks:
        imported.note(f"{listed(alone)}: no odometry, so the motion capture is track and truth")
        imported.tracks = dict(imported.truth)


def _name_radios(imported: Imported, said: Mapped, asked: Asked, topics: list[_Ranges]) -> None:
    """Radios' names become those of the devices that carry them."""
    ranges = imported.ranges
    taken = {radio.user for radio in said.radios.values()} | {new for _, new in asked.renamed}
    of = carriers(topics, imported.tracks.keys(), {*said.radios, *(old for old, _ in asked.renamed)}, taken)
    ends = set(ranges.a)
    if "?" in ends and "?" not in of:
        unclear = sum(name == "?" for name in ranges.a)
        imported.note(
            f"{unclear} ranges do not say who measured them and are left out (--topic 'NAME a=DEVICE' says it)"
        )
        imported.ranges = ranges = ranges.rows([k for k, name in enumerate(ranges.a) if name != "?"])
    renamed = {radio: user for radio, user in of.items() if radio != user}
    if renamed:
        imported.note("radios' places on devices are not known: they are taken to be at the origins of the poses")
        pairs = [f"{radio} = {user}" for radio, user in sorted(renamed.items())]
        imported.note(f"radios are taken to be those of devices, by topics, names or numbers: {listed(pairs)}")
        ranges.a = [renamed.get(name, name) for name in ranges.a]
        ranges.b = [renamed.get(name, name) for name in ranges.b]


def _tell(imported: Imported, roles: Roles) -> None:
    unclear = sorted(name for name, why in roles.rest.items() if why.startswith(("may have", "a type")))
    for name in unclear:
        imported.note(f"{name} is not read: {roles.rest[name]}")
