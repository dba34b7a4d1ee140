"""Writes a recording, and an answer about it, as a file that rerun shows. Needs the extra `rerun`.

| entity | what |
|---|---|
| world/<user> | the device in the common frame over time, with its name; in its own SLAM's where there is no answer |
| tracks/<user> | its whole way |
| regions/<user> | the 95 % region of its place, of a replay as it was known then |
| ranges | the ranges of each 0.2 s as lines between those who measured them, by verdict |
| residuals/<verdict> | measured minus predicted, m |
| sigma/<user>, progress/<user>, states/<user> | over time, of a replay; states as text, when they change |
| events | what was told, of a replay |

The timeline is `time`, in s since the first range, by the range clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.exported import Exported
from synchronizar.data.range_ends import range_lines
from synchronizar.data.recording import Recording
from synchronizar.data.regions import regions_of
from synchronizar.data.registration import Registration
from synchronizar.data.track import Track
from synchronizar.data.updates import Update
from synchronizar.errors import os_faults
from synchronizar.parameters import Parameters

if TYPE_CHECKING:
    from rerun import RecordingStream

_TIMELINE = "time"
_USED, _REJECTED = (136, 136, 136), (213, 94, 0)
# Okabe and Ito's colours, told apart by nearly everybody.
_COLORS = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233), (213, 94, 0))


def write_rerun(path: Path, exported: Exported) -> None:
    """Write the file. Raises InputError where it cannot be written."""
    import rerun as rr

    recording, registration, updates = exported.recording, exported.registration, exported.updates

    with os_faults(path), path.open("wb"):
        pass  # rerun itself tells of a place that cannot be written in a way of its own
    stream = rr.RecordingStream("synchronizar", recording_id=path.stem)
    stream.save(path)
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    began = float(recording.ranges.t.min()) if len(recording.ranges) else 0.0
    for n, (name, track) in enumerate(sorted(exported.shown.items())):
        offset = 0.0 if registration is None else registration.users[name].clock_offset or 0.0
        _track(stream, name, track, track.t - offset - began, _COLORS[n % len(_COLORS)])
        if registration is not None:
            _regions(stream, registration, name, track, updates, began + offset, _COLORS[n % len(_COLORS)])
    if registration is not None:
        _ranges(stream, recording, registration, exported.shown, began)
    _states(stream, updates, began)
    stream.flush()
    stream.disconnect()


def _entity(*parts: str) -> list[str]:
    """A path whose parts may have any letters."""
    return list(parts)


def _columns(stream: RecordingStream, entity: list[str], t: Array, columns: Any) -> None:
    import rerun as rr

    stream.send_columns(rr.new_entity_path(entity), [rr.TimeColumn(_TIMELINE, duration=t)], columns)


def _track(stream: RecordingStream, name: str, track: Track, t: Array, color: tuple[int, int, int]) -> None:
    import rerun as rr

    here = _entity("world", name)
    point = rr.Points3D([[0.0, 0.0, 0.0]], colors=color, radii=0.06, labels=name)
    if len(track) == 1:
        place = rr.Transform3D(translation=track.position[0], quaternion=track.quat_xyzw[0])
        stream.log(rr.new_entity_path(here), place, point, static=True)
        return
    _columns(stream, here, t, rr.Transform3D.columns(translation=track.position, quaternion=track.quat_xyzw))
    stream.log(rr.new_entity_path(here), point, static=True)
    way = rr.LineStrips3D([track.position], colors=color, radii=0.01)
    stream.log(rr.new_entity_path(_entity("tracks", name)), way, static=True)


def _regions(
    stream: RecordingStream,
    registration: Registration,
    name: str,
    track: Track,
    updates: Sequence[Update],
    clock: float,
    color: tuple[int, int, int],
) -> None:
    """The ellipsoids, each where the device was when it was known: of a whole walk's answer the one at its end."""
    import rerun as rr

    regions = regions_of(registration, name, updates)
    if regions is None:
        return
    entity = _entity("regions", name)
    if not updates or registration.users[name].static:
        # A radio's last region, and a whole walk's only one.
        end = rr.Ellipsoids3D(
            half_sizes=regions.size[-1:] / 2.0,
            centers=track.position[-1:],
            quaternions=regions.quat_xyzw[-1:],
            colors=color,
        )
        stream.log(rr.new_entity_path(entity), end, static=True)
        return
    began = min(update.t for update in updates)
    t = np.maximum(regions.since, began)
    offset = registration.users[name].clock_offset or 0.0
    place, valid = track.positions_at(t + offset, Parameters().slam.longest_pose_gap)
    if not valid.any():
        return
    ellipsoids = rr.Ellipsoids3D.columns(
        half_sizes=regions.size[valid] / 2.0, centers=place[valid], quaternions=regions.quat_xyzw[valid]
    )
    _columns(stream, entity, t[valid] - (clock - offset), ellipsoids)
    stream.log(rr.new_entity_path(entity), rr.Ellipsoids3D.from_fields(colors=[color]), static=True)


def _ranges(
    stream: RecordingStream,
    recording: Recording,
    registration: Registration,
    tracks: Mapping[str, Track],
    began: float,
) -> None:
    import rerun as rr

    ranges, verdicts = recording.ranges, registration.ranges
    order = np.argsort(ranges.t, kind="stable")
    for word, there in (("used", verdicts.used), ("rejected", verdicts.usable & ~verdicts.used)):
        rows = order[there[order]]
        if len(rows):
            residuals = rr.Scalars.columns(scalars=verdicts.residual[rows])
            _columns(stream, _entity("residuals", word), ranges.t[rows] - began, residuals)
    for t, ends, used in range_lines(ranges, registration, tracks, Parameters().slam.longest_pose_gap):
        stream.set_time(_TIMELINE, duration=t - began)
        colors = [_USED if one else _REJECTED for one in used]
        stream.log("ranges", rr.LineStrips3D(ends, colors=colors, radii=0.008))
    stream.reset_time()


def _states(stream: RecordingStream, updates: Sequence[Update], began: float) -> None:
    import rerun as rr

    t = np.array([update.t - began for update in updates])
    for name in updates[0].users if updates else ():
        users = [update.users[name] for update in updates]
        _columns(stream, _entity("progress", name), t, rr.Scalars.columns(scalars=[user.progress for user in users]))
        sigma = np.array(
            [np.nan if user.covariance is None else np.sqrt(np.trace(user.covariance[:2, :2]) / 2.0) for user in users]
        )
        known = np.isfinite(sigma)
        if known.any():
            _columns(stream, _entity("sigma", name), t[known], rr.Scalars.columns(scalars=sigma[known]))
        changes = [n for n, user in enumerate(users) if n == 0 or user.state is not users[n - 1].state]
        _columns(
            stream,
            _entity("states", name),
            t[changes],
            rr.TextLog.columns(text=[str(users[n].state) for n in changes]),
        )
    for update in updates:
        for event in update.events:
            stream.set_time(_TIMELINE, duration=update.t - began)
            stream.log("events", rr.TextLog(event))
    stream.reset_time()
