"""Writes a recording, and an answer about it, as an MCAP file that Foxglove shows. Needs the extra `mcap`.

Messages are JSON by Foxglove's own schemas (https://docs.foxglove.dev/docs/sdk/schemas), so that no plugin is needed:

| topic | schema | what |
|---|---|---|
| /tf | foxglove.FrameTransform | each device in the common frame, or in its own SLAM's where there is no answer |
| /tracks/<user> | foxglove.PosesInFrame | its whole way, once |
| /scene | foxglove.SceneUpdate | names and uncertainty at 2 Hz |
| /ranges | synchronizar.Range | each range: a, b, distance, residual, verdict |
| /states/<user> | synchronizar.State | state, progress and sigma over time, where a replay wrote updates.jsonl |
"""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from synchronizar.data.recording import Recording
from synchronizar.data.registration import RangeVerdicts, Registration
from synchronizar.data.track import Track
from synchronizar.data.updates import Update
from synchronizar.errors import os_faults

COMMON = "common"
_SCENE_S = 0.5
_LONGEST_PATH = 5000
"""Poses of a whole way, at most; more are thinned evenly."""
_NUMBER, _INTEGER, _TEXT, _TRUTH = ({"type": kind} for kind in ("number", "integer", "string", "boolean"))
_PRIMITIVES = "arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models"
"""All that an entity of a scene may be made of; each has to be there, empty or not."""


def _object(**properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _list(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


# Foxglove reads a part of JSON Schema only: one type for each field, `properties` in each object, no null. What is not
# known is left out of a message.
_TIME = _object(sec=_INTEGER, nsec=_INTEGER)
_VECTOR = _object(**dict.fromkeys("xyz", _NUMBER))
_QUATERNION = _object(**dict.fromkeys("xyzw", _NUMBER))
_POSE = _object(position=_VECTOR, orientation=_QUATERNION)
_COLOR = _object(**dict.fromkeys("rgba", _NUMBER))
_SPHERE = _object(pose=_POSE, size=_VECTOR, color=_COLOR)
_TEXT_ABOVE = _object(pose=_POSE, billboard=_TRUTH, font_size=_NUMBER, scale_invariant=_TRUTH, color=_COLOR, text=_TEXT)
_ENTITY = _object(
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_TIME,
    frame_locked=_TRUTH,
    metadata=_list(_object(key=_TEXT, value=_TEXT)),
    **{kind: _list(_object()) for kind in _PRIMITIVES} | {"spheres": _list(_SPHERE), "texts": _list(_TEXT_ABOVE)},
)
_SCHEMAS: dict[str, dict[str, Any]] = {
    "foxglove.FrameTransform": _object(
        timestamp=_TIME, parent_frame_id=_TEXT, child_frame_id=_TEXT, translation=_VECTOR, rotation=_QUATERNION
    ),
    "foxglove.PosesInFrame": _object(timestamp=_TIME, frame_id=_TEXT, poses=_list(_POSE)),
    "foxglove.SceneUpdate": _object(
        deletions=_list(_object(timestamp=_TIME, type=_INTEGER, id=_TEXT)), entities=_list(_ENTITY)
    ),
    "synchronizar.Range": _object(t=_NUMBER, a=_TEXT, b=_TEXT, distance=_NUMBER, residual=_NUMBER, verdict=_TEXT),
    "synchronizar.State": _object(t=_NUMBER, state=_TEXT, progress=_NUMBER, sigma_xy=_NUMBER, cue=_TEXT),
}
# Okabe and Ito's colours, told apart by nearly everybody.
_COLORS = (
    (0.0, 0.45, 0.7),
    (0.9, 0.6, 0.0),
    (0.0, 0.62, 0.45),
    (0.8, 0.47, 0.65),
    (0.34, 0.71, 0.91),
    (0.84, 0.37, 0.0),
)


class _Message(NamedTuple):
    t: float
    topic: str
    schema: str
    value: dict[str, Any]


def write_mcap(
    path: Path,
    recording: Recording,
    registration: Registration | None = None,
    tracks: Mapping[str, Track] | None = None,
    updates: Sequence[Update] = (),
) -> None:
    """Write the file. With an answer, `tracks` are those in the common frame. Raises InputError where it cannot be."""
    from mcap.writer import Writer

    shown, frame = (recording.tracks, None) if registration is None else (tracks or {}, COMMON)
    verdicts = None if registration is None else registration.ranges
    streams: list[Iterable[_Message]] = [_ranges(recording, verdicts), _states(updates)]
    for n, (name, track) in enumerate(sorted(shown.items())):
        parent = frame or f"{name}/slam"
        sigma = None if registration is None else _sigma(registration, name)
        streams += [_way(name, track, parent), _moves(name, track, parent), _scene(name, track, sigma, n)]
    with os_faults(path), path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="synchronizar")
        channels: dict[tuple[str, str], int] = {}
        schemas: dict[str, int] = {}
        for message in heapq.merge(*streams, key=lambda message: message.t):
            if message.schema not in schemas:
                schema = {"title": message.schema, **_SCHEMAS[message.schema]}
                schemas[message.schema] = writer.register_schema(
                    message.schema, "jsonschema", json.dumps(schema).encode()
                )
            place = message.topic, message.schema
            if place not in channels:
                channels[place] = writer.register_channel(message.topic, "json", schemas[message.schema])
            stamp = max(0, round(1e9 * message.t))
            writer.add_message(channels[place], stamp, json.dumps(message.value, allow_nan=False).encode(), stamp)
        writer.finish()


def _ranges(recording: Recording, verdicts: RangeVerdicts | None) -> Iterator[_Message]:
    ranges, names = recording.ranges, [user.name for user in recording.users]
    for row in np.argsort(ranges.t, kind="stable").tolist():
        distance = float(ranges.distance[row])
        if not np.isfinite(distance):
            continue
        residual, verdict = None, "unknown"
        if verdicts is not None:
            off = float(verdicts.residual[row])
            residual = off if np.isfinite(off) else None
            verdict = "used" if verdicts.used[row] else "rejected" if verdicts.usable[row] else "unusable"
        t = float(ranges.t[row])
        ends = {"a": names[ranges.a[row]], "b": names[ranges.b[row]]}
        value = {"t": t, **ends, "distance": distance, "residual": residual, "verdict": verdict}
        yield _Message(t, "/ranges", "synchronizar.Range", _known(value))


def _states(updates: Sequence[Update]) -> Iterator[_Message]:
    for update in updates:
        for name, user in update.users.items():
            sigma = None if user.covariance is None else float(np.sqrt(np.trace(user.covariance[:2, :2]) / 2.0))
            value = {
                "t": update.t,
                "state": str(user.state),
                "progress": user.progress,
                "sigma_xy": sigma if sigma is not None and np.isfinite(sigma) else None,
                "cue": user.cue,
            }
            yield _Message(update.t, f"/states/{name}", "synchronizar.State", _known(value))


def _way(name: str, track: Track, parent: str) -> Iterator[_Message]:
    kept = np.unique(np.linspace(0, len(track) - 1, min(len(track), _LONGEST_PATH)).astype(int)).tolist()
    poses = [
        {"position": _xyz(track.position[row].tolist()), "orientation": _xyzw(track.quat_xyzw[row].tolist())}
        for row in kept
    ]
    t = float(track.t[0])
    value = {"timestamp": _stamp(t), "frame_id": parent, "poses": poses}
    yield _Message(t, f"/tracks/{name}", "foxglove.PosesInFrame", value)


def _moves(name: str, track: Track, parent: str) -> Iterator[_Message]:
    rows = zip(track.t.tolist(), track.position.tolist(), track.quat_xyzw.tolist(), strict=True)
    for t, position, quat in rows:
        value = {
            "timestamp": _stamp(t),
            "parent_frame_id": parent,
            "child_frame_id": name,
            "translation": _xyz(position),
            "rotation": _xyzw(quat),
        }
        yield _Message(t, "/tf", "foxglove.FrameTransform", value)


def _scene(name: str, track: Track, sigma: float | None, n: int) -> Iterator[_Message]:
    """Its name above it, and a ball of 2 sigma about it."""
    red, green, blue = _COLORS[n % len(_COLORS)]
    here = {"position": _xyz([0.0, 0.0, 0.0]), "orientation": _xyzw([0.0, 0.0, 0.0, 1.0])}
    above = {"position": _xyz([0.0, 0.0, 0.3]), "orientation": _xyzw([0.0, 0.0, 0.0, 1.0])}
    solid = {"r": red, "g": green, "b": blue, "a": 1.0}
    size = 2.0 * 2.0 * min(max(sigma or 0.05, 0.025), 5.0)
    for t in np.arange(track.t[0], track.t[-1] + _SCENE_S, _SCENE_S).tolist():
        entity = {
            "timestamp": _stamp(t),
            "frame_id": name,
            "id": name,
            "lifetime": {"sec": 1, "nsec": 0},
            "frame_locked": True,
            "metadata": [],
            **{kind: [] for kind in _PRIMITIVES},
            "texts": [
                {
                    "pose": above,
                    "billboard": True,
                    "font_size": 0.2,
                    "scale_invariant": False,
                    "color": solid,
                    "text": name,
                }
            ],
            "spheres": [{"pose": here, "size": _xyz([size, size, size]), "color": {**solid, "a": 0.35}}],
        }
        yield _Message(t, "/scene", "foxglove.SceneUpdate", {"deletions": [], "entities": [entity]})


def _sigma(registration: Registration, name: str) -> float | None:
    covariance = registration.users[name].covariance
    if covariance is None or not np.isfinite(covariance[:3, :3]).all():
        return None
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))


def _known(value: dict[str, Any]) -> dict[str, Any]:
    """Without what is not known."""
    return {name: of for name, of in value.items() if of is not None}


def _stamp(t: float) -> dict[str, int]:
    sec, nsec = divmod(max(0, round(1e9 * t)), 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def _xyz(values: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", values, strict=True))


def _xyzw(values: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyzw", values, strict=True))
