"""Builds a recording from arrays, checked as files are; errors name the argument at fault."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from synchronizar.arrays import Array, Indices
from synchronizar.data.ranges import SOURCES, Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.geometry import Up
from synchronizar.io.ranges_csv import OPTIONAL, REQUIRED, antenna_indices
from synchronizar.io.recording_toml import read_up, read_user
from synchronizar.io.text import MAX_LENGTH, MAX_PLACE, MAX_STAMP, MIN_SIGMA, is_name, quoted
from synchronizar.io.tum import track_of_rows


def recording_from_arrays(
    tracks: Mapping[str, tuple[ArrayLike, ArrayLike, ArrayLike]],
    ranges: Iterable[Sequence[Any]] | Mapping[str, Sequence[Any]],
    up: Up,
    users: Mapping[str, Mapping[str, Any]],
) -> Recording:
    """The recording of `Recording.from_arrays`. Raises InputError that names the argument at fault."""
    default_up = read_up("up", "it", up)
    by_name = {name: User(name, up=default_up) for name in tracks}
    for name, settings in users.items():
        by_name[name] = read_user("users", f"users[{name!r}]", name, settings, default_up)
    for name, user in by_name.items():
        if not isinstance(name, str) or not is_name(name):
            raise InputError("tracks" if name in tracks else "users", f"{quoted(str(name))} cannot be a user's name")
        if user.static and name in tracks:
            raise InputError(f"tracks[{name!r}]", "the user is static and cannot have a track")
        if not user.static and name not in tracks:
            raise InputError(f"users[{name!r}]", "the user has no track and is not static")
    if not by_name:
        raise InputError("tracks", "has no user")
    in_order = tuple(by_name[name] for name in sorted(by_name))
    checked = {name: _track(f"tracks[{name!r}]", track, by_name[name].up) for name, track in tracks.items()}
    return Recording(in_order, checked, _ranges(ranges, in_order))


def _track(place: str, track: tuple[ArrayLike, ArrayLike, ArrayLike], up: Up) -> Track:
    try:
        t, position, quat = track
    except (TypeError, ValueError):
        raise InputError(place, "must be (t, positions, quats_xyzw)") from None
    stamps = _numbers(f"{place}[0]", t)
    n = len(stamps) if stamps.ndim else 0
    if n == 0 or stamps.shape != (n,):
        raise InputError(f"{place}[0]", f"stamps must have shape (n,) with n > 0, not {stamps.shape}")
    columns = [stamps[:, None]]
    for k, (what, values, width) in enumerate((("positions", position, 3), ("quaternions", quat, 4)), start=1):
        array = _numbers(f"{place}[{k}]", values)
        if array.shape != (n, width):
            raise InputError(f"{place}[{k}]", f"{what} must have shape ({n}, {width}), not {array.shape}")
        columns.append(array)
    rows = np.concatenate(columns, axis=1)
    for bad, k, fault in (
        (
            ~np.isfinite(rows[:, 0]) | (np.abs(rows[:, 0]) > MAX_STAMP),
            0,
            f"is no stamp in seconds within {MAX_STAMP:g}",
        ),
        (~(np.abs(rows[:, 1:4]) <= MAX_PLACE).all(axis=1), 1, f"is no position within {MAX_PLACE:g} m"),
        (~np.isfinite(rows[:, 4:]).all(axis=1) | ~rows[:, 4:].any(axis=1), 2, "is no quaternion"),
    ):
        if bad.any():
            raise InputError(f"{place}[{k}][{int(bad.argmax())}]", fault)
    return track_of_rows(rows, up)


def _numbers(place: str, values: ArrayLike) -> Array:
    try:
        return np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(place, "must be an array of numbers") from None


def _ranges(ranges: Iterable[Sequence[Any]] | Mapping[str, Sequence[Any]], users: tuple[User, ...]) -> Ranges:
    columns = _columns(ranges)
    n = len(columns["t"])
    for name, column in columns.items():
        if len(column) != n:
            raise InputError(f"ranges[{name!r}]", f"has {len(column)} values, t has {n}")

    def refuse(name: str, bad: NDArray[np.bool_], expected: str) -> None:
        if bad.any():
            k = int(bad.argmax())
            raise InputError(f"ranges[{k}]", f"{name} is {quoted(str(columns[name][k]))}: {expected}")

    t = _column("t", columns["t"])
    refuse("t", ~(np.abs(t) <= MAX_STAMP), f"a stamp is in seconds, within {MAX_STAMP:g}")
    index_of = {user.name: u for u, user in enumerate(users)}
    a, b = (_indices([index_of.get(_text(name), -1) for name in columns[end]]) for end in ("a", "b"))
    refuse("a", a < 0, "no user has that name; a static radio needs users={name: {'static': True}}")
    refuse("b", b < 0, "no user has that name; a static radio needs users={name: {'static': True}}")
    refuse("b", a == b, "a device cannot measure the distance to itself")
    optional: dict[str, Array | Indices] = {
        name: _column(name, columns[name]) for name in ("sigma", "rx_power", "fp_power", "nlos") if name in columns
    }
    if "sigma" in optional:
        sigma = optional["sigma"]
        refuse("sigma", ~np.isnan(sigma) & ~((sigma >= MIN_SIGMA) & (sigma <= MAX_LENGTH)), "it must be positive (m)")
    if "nlos" in optional:
        nlos = optional["nlos"]
        refuse("nlos", ~np.isnan(nlos) & (nlos != 0.0) & (nlos != 1.0), "it must be 0, 1 or None")
    if "source" in columns:
        word = {source: k for k, source in enumerate(SOURCES)}
        optional["source"] = _indices([word.get(_text(source), -1) for source in columns["source"]])
    for name, who in (("antenna_a", a), ("antenna_b", b)):
        named = [_text(antenna) for antenna in columns.get(name, [""] * n)]
        optional[name], unknown = antenna_indices(users, who, named)
        if unknown is not None:
            known = ", ".join(users[int(who[unknown])].antennas)
            raise InputError(f"ranges[{unknown}]", f"{name} is {quoted(named[unknown])}: there are {known}")
    return Ranges.of(t, a, b, _column("range", columns["range"]), **optional)


def _columns(ranges: Iterable[Sequence[Any]] | Mapping[str, Sequence[Any]]) -> dict[str, Sequence[Any]]:
    """Columns by name, from ranges given as rows or as columns."""
    if isinstance(ranges, Mapping):
        if missing := [name for name in REQUIRED if name not in ranges]:
            raise InputError("ranges", f"lacks {', '.join(missing)}")
        if unknown := [name for name in ranges if name not in REQUIRED + OPTIONAL]:
            raise InputError(
                "ranges", f"has no column {quoted(str(unknown[0]))}: there are {', '.join(REQUIRED + OPTIONAL)}"
            )
        return dict(ranges)
    try:
        rows = [tuple(row) for row in ranges]
    except TypeError:
        raise InputError("ranges", "must be rows (t, a, b, distance), or columns by name") from None
    for k, row in enumerate(rows):
        if len(row) != len(REQUIRED):
            raise InputError(f"ranges[{k}]", f"must be (t, a, b, distance), has {len(row)} values")
    return {name: [row[k] for row in rows] for k, name in enumerate(REQUIRED)}


def _column(name: str, values: Sequence[Any]) -> Array:
    """(n,) numbers; NaN for None."""
    if isinstance(values, np.ndarray) and values.dtype.kind in "fiub" and values.ndim == 1:
        return values.astype(float)
    try:
        return np.array([np.nan if value is None else float(value) for value in values])
    except (TypeError, ValueError):
        bad = next(k for k, value in enumerate(values) if not _is_number(value))
        raise InputError(f"ranges[{bad}]", f"{name} is {quoted(str(values[bad]))}: it must be a number") from None


def _is_number(value: object) -> bool:
    try:
        float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return value is None
    return True


def _text(value: object) -> str:
    return "" if value is None else str(value)


def _indices(values: list[int]) -> Indices:
    return np.array(values, dtype=np.int32)
