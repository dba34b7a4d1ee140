"""Poses that are missing, frozen or too few, devices that never move, attitudes that were never written."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.diagnosis.attitudes import NOT_USED
from synchronizar.diagnosis.stamps import duration
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.suspect_poses import frozen_runs


def pose_gap_findings(recording: Recording, parameters: Parameters) -> list[Finding]:
    """Of each track with stretches in which ranges were measured and poses are missing."""
    found = []
    longest, limits = parameters.slam.longest_pose_gap, parameters.diagnosis
    for name, track in recording.tracks.items():
        dt = np.diff(track.t)
        usual = float(np.median(dt)) if len(dt) else 0.0
        if usual > limits.sparse_interval:
            continue
        wide = np.flatnonzero(dt > max(longest, limits.gap_intervals * usual))
        t = own_range_times(recording, name)
        inside = np.searchsorted(t, track.t[wide + 1]) - np.searchsorted(t, track.t[wide], side="right")
        wide, inside = wide[inside > 0], inside[inside > 0]
        if not len(wide):
            continue
        worst = wide[np.argmax(dt[wide])]
        stretches = "one stretch" if len(wide) == 1 else f"{len(wide)} stretches"
        found.append(
            Finding(
                Code.POSE_GAP,
                name,
                f"{stretches} without poses, {duration(float(dt[wide].sum()))} in all, the longest of "
                f"{duration(float(dt[worst]))} at {track.t[worst]:.3f} s: {inside.sum()} of its {len(t)} ranges cannot "
                "be used",
                "look whether SLAM lost tracking there",
            )
        )
    return found


def frozen_pose_findings(recording: Recording, parameters: Parameters) -> list[Finding]:
    """Of each track in which a pose is repeated while the device moved on."""
    found = []
    for name, track in recording.tracks.items():
        runs = frozen_runs(track, parameters)
        if not runs:
            continue
        seconds = sum(float(track.t[run.last] - track.t[run.first]) for run in runs)
        times = "once" if len(runs) == 1 else f"{len(runs)} times"
        count = sum(run.last - run.first for run in runs)
        found.append(
            Finding(
                Code.FROZEN_POSES,
                name,
                f"SLAM lost tracking {times}: it repeated one pose and then was somewhere else ({count} poses, "
                f"{duration(seconds)} in all, first at {track.t[runs[0].first]:.3f} s), which are not used",
                "write no poses while SLAM has lost tracking",
            )
        )
    return found


def sparse_pose_findings(recording: Recording, parameters: Parameters) -> list[Finding]:
    """Of each track with too few poses to use its ranges, or to tell where a device that moves was in between."""
    found = []
    longest, limits = parameters.slam.longest_pose_gap, parameters.diagnosis
    for name, track in recording.tracks.items():
        if len(track) < 2:
            continue
        interval = float(np.median(np.diff(track.t)))
        if interval <= (longest if track.extent() < limits.moving_extent else limits.sparse_interval):
            continue
        lost = f": ranges between poses more than {longest:g} s apart cannot be used" if interval > longest else ""
        found.append(
            Finding(
                Code.SPARSE_POSES,
                name,
                f"it has only one pose every {interval:.2f} s{lost}",
                "write the poses at 10 Hz or more",
            )
        )
    return found


def never_moves_findings(recording: Recording, parameters: Parameters) -> list[Finding]:
    """Of each device with a track that stands still: nobody can tell its heading from ranges."""
    found, limits = [], parameters.diagnosis
    for user in recording.users:
        if user.static or not len(own_range_times(recording, user.name)):
            continue
        track = recording.tracks[user.name]
        if len(track) < 2 or track.extent() > limits.still_extent or attitude_span(track) > limits.still_turn:
            continue
        remedy = (
            "if its antennas are anchors in a room, make each a user of its own with `static = true`; if it is a "
            "device that can be carried, walk with it"
            if len(user.antennas) > 1
            else "if it is a beacon, remove its track and write `static = true` in recording.toml; if it is a device "
            "that can be carried, walk with it"
        )
        seen = (
            f"it stands still: its {len(track)} poses lie within {track.extent():.3f} m and "
            f"{np.degrees(attitude_span(track)):.1f} deg"
        )
        found.append(Finding(Code.NEVER_MOVES, user.name, seen, remedy))
    return found


def attitude_findings(recording: Recording, parameters: Parameters) -> list[Finding]:
    """Of each device that moves and never turns at all."""
    found = []
    for user in recording.users:
        if user.static:
            continue
        track = recording.tracks[user.name]
        if not attitude_is_the_same(track, parameters):
            continue
        what = "the identity" if abs(track.quat_xyzw[0, 3]) > 1.0 - 1e-6 else "the same"
        has = NOT_USED if user.antennas else ""
        found.append(
            Finding(
                Code.ATTITUDE_UNKNOWN,
                user.name,
                f"its attitude is {what} throughout while it moves over {track.extent():.1f} m, so it was likely never "
                f"measured{has}",
                "write the attitude that SLAM estimates"
                + ("" if not user.antennas else ", or remove its antennas from recording.toml"),
            )
        )
    return found


def attitude_is_the_same(track: Track, parameters: Parameters) -> bool:
    """Whether a device moves and never turns at all."""
    limits = parameters.diagnosis
    if len(track) < limits.fewest_poses or track.extent() < limits.moving_extent:
        return False
    return attitude_span(track) <= limits.attitude_noise


def attitude_span(track: Track) -> float:
    """How far any attitude is from the first one (rad)."""
    q = track.quat_xyzw
    away = np.minimum(np.linalg.norm(q - q[0], axis=1), np.linalg.norm(q + q[0], axis=1))
    return float(4.0 * np.arcsin(np.clip(0.5 * away.max(), 0.0, 1.0)))


def own_range_times(recording: Recording, name: str) -> Array:
    """The stamps of a user's ranges, in order."""
    u = recording.index(name)
    return np.sort(recording.ranges.t[(recording.ranges.a == u) | (recording.ranges.b == u)])
