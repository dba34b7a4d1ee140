"""Objects of a room: they belong to it, in the common frame; who holds one may move it, for as long as it says so."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from synchronizar.live.messages import (
    APP,
    LARGEST_DATA,
    LONGEST_NAME,
    Create,
    MessageError,
    Move,
    Object,
    Objects,
    Quaternion,
    Vector,
    all_finite,
    data_size,
)

LEASE_S = 5.0
"""s: who holds an object and says nothing for so long, holds it no more (a heartbeat comes every 2 s)."""
MOST_OBJECTS = 2000
MOST_DATA = 4 * 1024 * 1024
"""Bytes of all objects' data together, as JSON: who comes is told all of it."""
_MOST_COORDINATE = 1e7

Placed = Callable[[str, Vector, Quaternion], tuple[Vector, Quaternion] | None]
"""A place in a device's own frame and axes, in the common frame; None while that device is not registered."""


class ObjectStore:
    """All objects of a room. Every change has a number, and clients hear the changes in that order."""

    def __init__(self, saved: Callable[[Object | str], None] | None = None) -> None:
        """`saved` hears each object as it now stands, and the id of each one that is gone."""
        self.version = 0
        self.objects: dict[str, Object] = {}
        self._leases: dict[str, float] = {}
        self._changed: dict[str, None] = {}
        self._removed: dict[str, None] = {}
        self._sizes: dict[str, int] = {}
        """Bytes of each object's data."""
        self._saved = saved

    def restore(self, objects: list[Object], app: bool = False) -> None:
        """As they stood before; nobody holds any, but those that are an application's, where there still is one."""
        kept = APP if app else None
        self.objects = {
            o.id: msgspec.structs.replace(o, holder=kept if o.holder == APP else None, velocity=None) for o in objects
        }
        self._sizes = {o.id: data_size(o.data) for o in objects}
        self._changed = dict.fromkeys(self.objects)

    def snapshot(self) -> Objects:
        """All that are placed."""
        return Objects(self.version, [o for o in self.objects.values() if o.waits_for is None])

    def create(self, message: Create, by: str, now: float, placed: Placed) -> Object:
        """A new one. Raises MessageError where it cannot be."""
        if message.id in self.objects:
            raise MessageError("object", f"there is an object {message.id!r} already: choose another id")
        self._check(message)
        self._keep_data(message.id, message.data)
        position, quat, waits = message.position, message.quat_xyzw, None
        if message.user is not None:
            place = placed(message.user, position, quat)
            if place is None:
                waits = message.user
            else:
                position, quat = place
        held = by if message.hold else None
        made = Object(message.id, message.kind, position, quat, by, held, None, now, message.data, waits)
        self.objects[made.id] = made
        if held is not None:
            self._hold(made.id, by, now)
        self._note(made)
        return made

    def put(self, was: Object) -> None:
        """An object as it stood in a recording, whoever held it then. Raises MessageError where it cannot be."""
        self._check(was)
        if was.velocity is not None:
            _check_place(was.velocity, was.quat_xyzw)
        self._keep_data(was.id, was.data)
        self._leases.pop(was.id, None)
        self.objects[was.id] = was
        self._note(was)

    def place_waiting(self, placed: Placed, now: float) -> None:
        """Put down those that waited for a device which is registered now."""
        for waiting in [o for o in self.objects.values() if o.waits_for is not None]:
            assert waiting.waits_for is not None
            if (place := placed(waiting.waits_for, waiting.position, waiting.quat_xyzw)) is not None:
                waiting.position, waiting.quat_xyzw = place
                waiting.waits_for, waiting.t = None, now
                self._note(waiting)

    def grab(self, id_: str, by: str, now: float) -> None:
        """`by` holds it from now on. Raises MessageError where somebody else does."""
        found = self._free(id_, by)
        self._hold(id_, by, now)
        if found.holder != by:
            found.holder = by
            self._note(found)

    def move(self, message: Move, by: str, now: float) -> None:
        """Where it is now. Raises MessageError unless `by` holds it."""
        found = self._known(message.id)
        if found.holder != by:
            raise MessageError("holder", f"{by} does not hold {message.id!r}: grab it first")
        position = found.position if message.position is None else message.position
        quat = found.quat_xyzw if message.quat_xyzw is None else message.quat_xyzw
        _check_place(position, quat)
        if message.velocity is not None:
            _check_place(message.velocity, quat)
        if message.data is not msgspec.UNSET:
            self._keep_data(message.id, message.data)
            found.data = message.data
        found.position, found.quat_xyzw, found.velocity, found.t = position, quat, message.velocity, now
        self._hold(message.id, by, now)
        self._note(found)

    def release(self, id_: str, by: str) -> None:
        """Nobody holds it any more. Raises MessageError unless `by` did."""
        found = self._known(id_)
        if found.holder != by:
            raise MessageError("holder", f"{by} does not hold {id_!r}")
        self._let_go(found)

    def remove(self, id_: str, by: str) -> None:
        """It is gone. Raises MessageError where somebody else holds it."""
        self._free(id_, by)
        self.drop(id_)

    def drop(self, id_: str) -> None:
        """It is gone, whoever held it. Raises MessageError where there is none."""
        self._known(id_)
        del self.objects[id_], self._sizes[id_]
        self._leases.pop(id_, None)
        self._changed.pop(id_, None)
        self._removed[id_] = None
        self._save(id_)

    def alive(self, by: str, now: float) -> None:
        """`by` said something: it keeps what it holds."""
        for id_, found in self.objects.items():
            if found.holder == by and id_ in self._leases:
                self._leases[id_] = now + LEASE_S

    def expire(self, now: float) -> None:
        """Whose lease has ended holds nothing any more; an application has none, since it is begun again."""
        for id_ in [id_ for id_, until in self._leases.items() if until < now]:
            self._let_go(self.objects[id_])

    def changes(self) -> Objects | None:
        """What changed since the last call; None where nothing did."""
        if not self._changed and not self._removed:
            return None
        changed = [self.objects[id_] for id_ in self._changed]
        out = Objects(self.version, [o for o in changed if o.waits_for is None], list(self._removed))
        self._changed, self._removed = {}, {}
        return out if out.changed or out.removed else None

    def _check(self, what: Create | Object) -> None:
        """Raises MessageError where an object cannot be so."""
        _check_id(what.id)
        _check_place(what.position, what.quat_xyzw)
        if len(what.kind) > LONGEST_NAME:
            raise MessageError("object", f"an object's kind has at most {LONGEST_NAME} characters")
        if what.id not in self.objects and len(self.objects) >= MOST_OBJECTS:
            raise MessageError("object", f"there are {MOST_OBJECTS} objects already: remove some first")

    def _hold(self, id_: str, by: str, now: float) -> None:
        if by != APP:
            self._leases[id_] = now + LEASE_S

    def _keep_data(self, id_: str, data: Any) -> None:
        """Count an object's data. Raises MessageError where it is too much."""
        size = data_size(data)
        if size > LARGEST_DATA:
            raise MessageError("size", f"data has at most {LARGEST_DATA} bytes as JSON")
        if sum(self._sizes.values()) - self._sizes.get(id_, 0) + size > MOST_DATA:
            raise MessageError("size", f"all objects' data have at most {MOST_DATA} bytes: remove some first")
        self._sizes[id_] = size

    def _known(self, id_: str) -> Object:
        if id_ not in self.objects:
            raise MessageError("object", f"there is no object {id_!r}")
        return self.objects[id_]

    def _free(self, id_: str, by: str) -> Object:
        found = self._known(id_)
        if found.holder not in (None, by):
            raise MessageError("holder", f"{found.holder} holds {id_!r}: wait until it is let go")
        return found

    def _let_go(self, found: Object) -> None:
        self._leases.pop(found.id, None)
        found.holder, found.velocity = None, None
        self._note(found)

    def _save(self, changed: Object | str) -> None:
        if self._saved is not None:
            self._saved(changed)

    def _note(self, changed: Object) -> None:
        self.version += 1
        if changed.waits_for is None:
            # It may have been removed since the last call: who hears both would not know which came last.
            self._removed.pop(changed.id, None)
        self._changed.pop(changed.id, None)
        self._changed[changed.id] = None
        self._save(changed)


def _check_id(id_: str) -> None:
    if not 0 < len(id_) <= LONGEST_NAME or not id_.isprintable():
        raise MessageError("object", f"an object's id has 1 to {LONGEST_NAME} printable characters")


def _check_place(position: Vector, quat_xyzw: Quaternion) -> None:
    if not all_finite(*position, *quat_xyzw) or max(map(abs, position)) > _MOST_COORDINATE:
        raise MessageError("value", "a place is three numbers in m and a quaternion x y z w")
    if not 1e-6 < sum(q * q for q in quat_xyzw) < 1e6:
        raise MessageError("value", "a quaternion is not zero: 0 0 0 1 is no turn")
