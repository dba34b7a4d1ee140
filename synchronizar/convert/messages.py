"""From messages to poses and ranges, whatever file they stand in: a bag or an MCAP file."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from synchronizar.convert.asked import Asked
from synchronizar.convert.assembling import listed
from synchronizar.convert.fields import Topic
from synchronizar.convert.guess import RANGE_WORDS, PoseRole, RangeRole, Roles, field_list, preferred, roles_of
from synchronizar.convert.imported import Imported
from synchronizar.convert.mapping import Mapped, mapped
from synchronizar.convert.message_clock import MessageClock
from synchronizar.convert.names import matched
from synchronizar.convert.radios import carriers
from synchronizar.convert.takers import Decode, Frames, Paths, Poses, Ranges
from synchronizar.convert.track_file import add_track, add_truth
from synchronizar.convert.transforms import Transforms
from synchronizar.errors import InputError
from synchronizar.progress import Progress

_STEP = 5000
_STAMPED = 0.5
"""Of a path's poses have to have a stamp of their own, at least."""


@contextmanager
def broken(path: Path | str, remedy: str) -> Iterator[None]:
    """Whatever the libraries that decode a file raise where it is broken, as an InputError that names it."""
    try:
        yield
    except (InputError, ModuleNotFoundError):
        raise
    except MemoryError as error:
        raise InputError(path, f"is broken, or there is not enough memory for it ({remedy})") from error
    except Exception as error:
        raise InputError(path, f"is broken: {_fault(error)} ({remedy})") from error


def _fault(error: Exception) -> str:
    if isinstance(error, KeyError | AttributeError):
        return f"has no {error.args[0]!r}" if isinstance(error, KeyError) else str(error)
    return str(error).rstrip(".") or type(error).__name__


class Messages(Protocol):
    """An open file of messages."""

    topics: list[Topic]
    remedy: str
    """What mends such a file, where it is broken."""

    def read(self, names: Collection[str]) -> Iterator[tuple[str, float, Decode, float]]:
        """Messages of some topics as they stand in the file: topic, when it was logged (s), message, share read.

        Raises whatever its library raises where the file is broken, as a message does when it is made.
        """


def listing(messages: Messages, asked: Asked, place: str) -> list[str]:
    """What topics there are, and what is guessed of each."""
    roles = _roles(messages, mapped(asked), place)
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
    roles = _roles(messages, said, place)
    imported = Imported()
    chosen = _chosen(roles, imported)
    frames = Transforms()
    poses = [Paths(role) if role.is_path else Poses(role) for role in chosen]
    ranges = [Ranges(role) for role in roles.ranges]
    takers: dict[str, Poses | Paths | Ranges | Frames] = {taker.topic: taker for taker in (*poses, *ranges)}
    takers |= {topic.name: Frames(topic, frames, asked) for topic in roles.transforms}
    if not takers:
        raise InputError(place, "has no topic of poses, transforms or ranges that is known: --list shows what it has")
    _take_all(messages, takers, place, progress)
    clock = MessageClock([*poses, *ranges], asked, imported)
    for taker in poses:
        rows = taker.rows(clock)
        if taker.role.is_path and len(np.unique(rows[:, 0])) < _STAMPED * len(rows):
            imported.note(f"{taker.topic} is left out: the poses in its messages have no stamps of their own")
            continue
        add = add_truth if taker.role.is_truth else add_track
        add(imported, taker.role.user, rows, asked)
    _add_frames(imported, frames, asked)
    for measured in ranges:
        measured.add_to(imported, clock.stamps(measured), asked)
    _truth_alone(imported)
    _name_radios(imported, said, asked, ranges)
    _tell(imported, roles)
    return imported


def _take_all(
    messages: Messages, takers: Mapping[str, Poses | Paths | Ranges | Frames], place: str, progress: Progress
) -> None:
    """Read the file once. Raises InputError where it is broken, or a message is."""
    furthest = 0.0
    with broken(place, messages.remedy):
        for count, (name, logged, decode, share) in enumerate(messages.read(takers)):
            try:
                takers[name].take(logged, decode)
            except MemoryError:
                raise
            except Exception as error:
                fault = f"a message of {name}, logged at {logged:.9g} s, cannot be read: {_fault(error)}"
                raise InputError(place, f"{fault} (--topic '{name} skip' leaves the topic out)") from error
            if count % _STEP == 0:
                furthest = max(furthest, share)
                progress(min(furthest, 1.0))
        for taker in takers.values():
            if isinstance(taker, Paths):
                taker.finish()
    progress(1.0)


def _roles(messages: Messages, said: Mapped, place: str) -> Roles:
    with broken(place, messages.remedy):
        return roles_of(messages.topics, said, _first_of(messages), place)


def _first_of(messages: Messages) -> Callable[[Topic], Any]:
    def first(topic: Topic) -> Any:
        return next((decode() for _, _, decode, _ in messages.read([topic.name])), None)

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


def _name_radios(imported: Imported, said: Mapped, asked: Asked, topics: list[Ranges]) -> None:
    """Radios' names become those of the devices that carry them."""
    ranges = imported.ranges
    surveyed = {name for name, user in imported.users.items() if user.position is not None}
    taken = {radio.user for radio in said.radios.values()} | {new for _, new in asked.renamed}
    known = {*said.radios, *surveyed, *(old for old, _ in asked.renamed)}
    of = carriers(topics, imported.tracks.keys(), known, taken)
    ends = set(ranges.a)
    if "?" in ends and "?" not in of:
        unclear = sum(name == "?" for name in ranges.a)
        imported.note(
            f"{unclear} ranges do not say who measured them and are left out (--topic 'NAME a=DEVICE' says it)"
        )
        imported.ranges = ranges = ranges.rows(np.array([name != "?" for name in ranges.a]))
    renamed = {radio: user for radio, user in of.items() if radio != user}
    if renamed:
        imported.note("radios' places on devices are not known: they are taken to be at the origins of the poses")
        pairs = [f"{radio} = {user}" for radio, user in sorted(renamed.items())]
        imported.note(f"radios are taken to be those of devices, by topics, names or numbers: {listed(pairs)}")
        ranges.a = [renamed.get(name, name) for name in ranges.a]
        ranges.b = [renamed.get(name, name) for name in ranges.b]


_USUAL = re.compile(
    r"(?:std|sensor|nav|geometry|tf2?|visualization|map|diagnostic|rosgraph|rcl_interfaces|trajectory|"
    r"shape|stereo|actionlib|dynamic_reconfigure|bond|lifecycle)_?(?:msgs)?/|foxglove[._]"
)
"""Types in which there are no ranges between devices."""


def _tell(imported: Imported, roles: Roles) -> None:
    if not roles.ranges:
        odd = sorted(name for name, why in roles.rest.items() if _may_have_ranges(name, why))
        if odd:
            imported.note(
                f"no topic of ranges is known: if {listed(odd)} has some, say --topic 'NAME range=FIELD a=WHO b=WHO'"
                " (--list shows fields)"
            )
    unclear = sorted(
        name for name, why in roles.rest.items() if why.startswith(("may have", "a type", "messages in", "protobuf"))
    )
    for name in unclear:
        imported.note(f"{name} is not read: {roles.rest[name]}")


def _may_have_ranges(topic: str, why: str) -> bool:
    """Of a topic that is not read and says no more of itself than its type."""
    is_type = "/" in why and " " not in why
    return is_type and (not _USUAL.match(why) or bool(RANGE_WORDS.search(topic)))
