"""Writes a recording, and an answer about it, as an MCAP file that Foxglove shows. Needs the extra `mcap`.

Messages are JSON by Foxglove's own schemas (https://docs.foxglove.dev/docs/sdk/schemas), so that no plugin is needed:

| topic | schema | what |
|---|---|---|
| /tf | foxglove.FrameTransform | each device in the common frame, or in its own SLAM's where there is no answer |
| /tracks/<user> | foxglove.PosesInFrame | its whole way, once |
| /scene | foxglove.SceneUpdate | names, and the 95 % region of each place, at 2 Hz; of a replay as it was known then |
| /range_lines | foxglove.SceneUpdate | the ranges of the last 0.2 s between those who measured them |
| /ranges | synchronizar.Range | each range: a, b, distance, residual, verdict |
| /states/<user> | synchronizar.State | state, progress, sigma, covariance over time, of a replay |

Beside the file stands a layout for Foxglove, which shows all of it (`foxglove_layout.py`).
"""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from synchronizar.data.exported import Exported
from synchronizar.data.range_ends import LINES_S, range_lines
from synchronizar.data.recording import Recording
from synchronizar.data.regions import UNKNOWN, Regions, regions_of
from synchronizar.data.registration import RangeVerdicts, Registration
from synchronizar.data.track import Track
from synchronizar.data.updates import Update
from synchronizar.errors import os_faults
from synchronizar.io.foxglove_layout import write_layout
from synchronizar.io.json_values import number_json
from synchronizar.parameters import Parameters
from synchronizar.quaternions import inverse_quaternions, multiply_quaternions

COMMON = "common"
_SCENE_S = 0.5
_LINE_LIST = 2
"""Foxglove's number for lines of which each has two points of its own."""
_VERDICT_COLORS = {"used": (0.53, 0.53, 0.53), "rejected": (0.84, 0.37, 0.0), "unknown": (0.34, 0.71, 0.91)}
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
_LINES = _object(
    type=_INTEGER,
    pose=_POSE,
    thickness=_NUMBER,
    scale_invariant=_TRUTH,
    points=_list(_VECTOR),
    color=_COLOR,
    colors=_list(_COLOR),
    indices=_list(_INTEGER),
)
_TEXT_ABOVE = _object(pose=_POSE, billboard=_TRUTH, font_size=_NUMBER, scale_invariant=_TRUTH, color=_COLOR, text=_TEXT)
_ENTITY = _object(
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_TIME,
    frame_locked=_TRUTH,
    metadata=_list(_object(key=_TEXT, value=_TEXT)),
    **{kind: _list(_object()) for kind in _PRIMITIVES}
    | {"spheres": _list(_SPHERE), "texts": _list(_TEXT_ABOVE), "lines": _list(_LINES)},
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
    "synchronizar.State": _object(
        t=_NUMBER,
        state=_TEXT,
        progress=_NUMBER,
        sigma_xy=_NUMBER,
        sigma_yaw=_NUMBER,
        covariance=_list(_NUMBER),
        cue=_TEXT,
    ),
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


def write_mcap(path: Path, exported: Exported) -> None:
    """Write the file, and its layout. Raises InputError where they cannot be written."""
    from mcap.writer import Writer

    recording, registration, updates = exported.recording, exported.registration, exported.updates
    shown, frame = exported.shown, None if registration is None else COMMON
    verdicts = None if registration is None else registration.ranges
    streams: list[Iterable[_Message]] = [_ranges(recording, verdicts), _states(updates)]
    for n, (name, track) in enumerate(sorted(shown.items())):
        parent = frame or f"{name}/slam"
        regions = UNKNOWN if registration is None else regions_of(registration, name, updates) or UNKNOWN
        streams += [_way(name, track, parent), _moves(name, track, parent), _scene(name, track, regions, n)]
    if registration is not None:
        streams.append(_range_lines(recording, registration, shown))
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
    write_layout(path, sorted(shown), [user.name for user in recording.users] if updates else [], frame)


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
            covariance = np.full((4, 4), np.nan) if user.covariance is None else user.covariance
            sigma_xy, sigma_yaw = np.sqrt(np.trace(covariance[:2, :2]) / 2.0), np.sqrt(covariance[3, 3])
            value = {
                "t": update.t,
                "state": str(user.state),
                "progress": user.progress,
                "sigma_xy": number_json(sigma_xy),
                "sigma_yaw": number_json(sigma_yaw),
                # Row by row, over x, y, z and yaw; a static radio's has no yaw.
                "covariance": covariance.ravel().tolist() if np.isfinite(covariance).all() else None,
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


def _range_lines(recording: Recording, registration: Registration, tracks: Mapping[str, Track]) -> Iterator[_Message]:
    """Every so often the ranges since the last time, as lines between the places of both devices."""
    longest_gap = Parameters().slam.longest_pose_gap
    for t, ends, used in range_lines(recording.ranges, registration, tracks, longest_gap):
        words = ["used" if one else "rejected" for one in used]
        lines = {
            "type": _LINE_LIST,
            "pose": {"position": _xyz([0.0, 0.0, 0.0]), "orientation": _xyzw([0.0, 0.0, 0.0, 1.0])},
            "thickness": 1.5,
            "scale_invariant": True,
            "points": [_xyz(place) for place in ends.reshape(-1, 3).tolist()],
            "color": _rgba(_VERDICT_COLORS["unknown"], 1.0),
            "colors": [_rgba(_VERDICT_COLORS[word], 0.8) for word in words for _ in range(2)],
            "indices": [],
        }
        entity = _entity(t, COMMON, "ranges", LINES_S, frame_locked=False) | {"lines": [lines]}
        yield _Message(t, "/range_lines", "foxglove.SceneUpdate", {"deletions": [], "entities": [entity]})


def _entity(t: float, frame: str, name: str, lifetime: float, frame_locked: bool) -> dict[str, Any]:
    """One of a scene, made of nothing yet."""
    return {
        "timestamp": _stamp(t),
        "frame_id": frame,
        "id": name,
        "lifetime": _stamp(lifetime),
        "frame_locked": frame_locked,
        "metadata": [],
        **{kind: [] for kind in _PRIMITIVES},
    }


def _scene(name: str, track: Track, regions: Regions, n: int) -> Iterator[_Message]:
    """Its name above it, and the 95 % region of its place about it; a small ball where nothing is known of it."""
    color = _COLORS[n % len(_COLORS)]
    above = {"position": _xyz([0.0, 0.0, 0.3]), "orientation": _xyzw([0.0, 0.0, 0.0, 1.0])}
    label = {
        "pose": above,
        "billboard": True,
        "font_size": 0.2,
        "scale_invariant": False,
        "color": _rgba(color, 1.0),
        "text": name,
    }
    ticks = np.arange(track.t[0], track.t[-1] + _SCENE_S, _SCENE_S)
    at = np.maximum(np.searchsorted(regions.since, ticks, side="right") - 1, 0)
    attitude = track.at(np.minimum(ticks, track.t[-1]), np.inf).quat_xyzw
    # The region as seen from the body, with which it goes until the next one.
    turned = multiply_quaternions(inverse_quaternions(attitude), regions.quat_xyzw[at])
    for t, size, orientation in zip(ticks.tolist(), regions.size[at].tolist(), turned.tolist(), strict=True):
        place = {"position": _xyz([0.0, 0.0, 0.0]), "orientation": _xyzw(orientation)}
        ball = {"pose": place, "size": _xyz(size), "color": _rgba(color, 0.35)}
        entity = _entity(t, name, name, 2.0 * _SCENE_S, frame_locked=True) | {"texts": [label], "spheres": [ball]}
        yield _Message(t, "/scene", "foxglove.SceneUpdate", {"deletions": [], "entities": [entity]})


def _known(value: dict[str, Any]) -> dict[str, Any]:
    """Without what is not known."""
    return {name: of for name, of in value.items() if of is not None}


def _stamp(t: float) -> dict[str, int]:
    sec, nsec = divmod(max(0, round(1e9 * t)), 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def _rgba(color: tuple[float, float, float], alpha: float) -> dict[str, float]:
    return dict(zip("rgba", (*color, alpha), strict=True))


def _xyz(values: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", values, strict=True))


def _xyzw(values: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyzw", values, strict=True))
