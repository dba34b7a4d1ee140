"""All that an engine knows, in a file: numbers in an npz archive, and how they belong together as JSON. No pickle.

Thousands of arrays are small, so that those of one type are one: with an entry for each an archive of thirty people
takes a second to write.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from collections import Counter
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.estimation.incremental.cues import Cue
from synchronizar.estimation.incremental.engine import Engine
from synchronizar.estimation.incremental.innovations import Innovations
from synchronizar.estimation.incremental.members import Joint
from synchronizar.estimation.incremental.slot_states import SlotTable
from synchronizar.estimation.incremental.snapshot import Candidate, Found, FoundRanges, FoundUser, SlotPoses
from synchronizar.estimation.incremental.standing import Placed, Standing
from synchronizar.estimation.incremental.tracking import NewRanges, Tracked
from synchronizar.estimation.integrity import Verdict
from synchronizar.graph.follower import FollowerState, LinearRows
from synchronizar.graph.slot_factors import Joining, SlamStep
from synchronizar.parameters import Parameters

_FORMAT = 14
_HEADER = "header"
_RECORDS: dict[str, type] = {
    record.__name__: record
    for record in (
        *(Candidate, Cue, FollowerState, Found, FoundRanges, FoundUser, Innovations, Joining, Joint, LinearRows),
        *(NewRanges, Placed, SlamStep, SlotPoses, SlotTable, Standing, Tracked, User, Verdict),
    )
}
_MALFORMED = (
    *(ValueError, LookupError, TypeError, AttributeError, ArithmeticError, AssertionError, RuntimeError, EOFError),
    *(MemoryError, BadZipFile, zlib.error),
)


def save(engine: Engine, path: str | Path, face: dict[str, Any]) -> None:
    """Write all that an engine knows, and what its face adds. Raises InputError where that cannot be.

    The file is whole or not there: an older one is replaced at the end.
    """
    arrays = _Arrays()
    known = {"users": list(engine.users), "reference": engine.reference, "face": face, "engine": engine.to_state()}
    header = json.dumps({"format": _FORMAT, "known": _packed(known, arrays)})
    file = Path(path)
    part = file.with_name(f"{file.name}.{os.getpid()}.part")
    with os_faults(file):
        try:
            with part.open("wb") as out:
                np.savez(out, **{_HEADER: np.array(header)}, **arrays.joined())  # type: ignore[arg-type]
                out.flush()
                os.fsync(out.fileno())
            part.replace(file)
        finally:
            part.unlink(missing_ok=True)


def load(path: str | Path, parameters: Parameters, workers: int) -> tuple[Engine, dict[str, Any]]:
    """An engine that goes on where the saved one was, and what its face added.

    Raises InputError where the file is none that `save` wrote, is damaged, or of another version.
    """
    file = Path(path)
    with os_faults(file):
        try:
            with np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            header = json.loads(str(arrays.pop(_HEADER)))
            version = header["format"]
        except _MALFORMED as error:
            raise InputError(file, "is no saved state, or damaged") from error
        if version != _FORMAT:
            raise InputError(file, f"has format {version!r}, not {_FORMAT}: another version saved it")
        try:
            known = _unpacked(header["known"], arrays)
            engine = Engine(tuple(known["users"]), known["reference"], parameters, workers)
            engine.restore(known["engine"])
            return engine, dict(known["face"])
        except _MALFORMED as error:
            raise InputError(file, "is damaged: what it says does not fit together") from error


class _Arrays:
    """Arrays as they are gathered, by type."""

    def __init__(self) -> None:
        self._of: dict[str, list[Array]] = {}
        self._sizes: Counter[str] = Counter()

    def add(self, array: Array) -> tuple[str, int, list[int]]:
        """Its type, where it begins among those of its type, and its shape."""
        name = array.dtype.name
        begin = self._sizes[name]
        self._of.setdefault(name, []).append(array.ravel())
        self._sizes[name] += array.size
        return name, begin, list(array.shape)

    def joined(self) -> dict[str, Array]:
        """By type, all one after the other."""
        return {name: np.concatenate(of) for name, of in self._of.items()}


def _packed(value: Any, arrays: _Arrays) -> Any:
    """A value as JSON: plain ones as they are, all others as a list that begins with what they are."""
    if isinstance(value, State):
        return ["state", str(value)]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return ["array", *arrays.add(value)]
    kind = type(value).__name__
    if kind in _RECORDS:
        of = [f.name for f in fields(value)] if is_dataclass(value) else value._fields
        return ["record", kind, {name: _packed(getattr(value, name), arrays) for name in of}]
    if isinstance(value, dict):
        return ["dict", [[_packed(key, arrays), _packed(of_key, arrays)] for key, of_key in value.items()]]
    if isinstance(value, list | tuple) and kind in ("list", "tuple"):
        return [kind, [_packed(each, arrays) for each in value]]
    raise TypeError(f"a {kind} has no place in a file")


def _unpacked(said: Any, arrays: dict[str, Array]) -> Any:
    """What `_packed` was given."""
    if not isinstance(said, list):
        return said
    kind, value, *rest = said
    if kind == "state":
        return State(value)
    if kind == "array":
        begin, shape = rest
        return arrays[value][begin : begin + math.prod(shape)].reshape(shape).copy()
    if kind == "record":
        return _RECORDS[value](**{name: _unpacked(of_name, arrays) for name, of_name in rest[0].items()})
    if kind == "dict":
        return {_unpacked(key, arrays): _unpacked(of_key, arrays) for key, of_key in value}
    if kind in ("list", "tuple"):
        each = [_unpacked(of, arrays) for of in value]
        return each if kind == "list" else tuple(each)
    raise ValueError(f"there is no kind {kind!r}")
