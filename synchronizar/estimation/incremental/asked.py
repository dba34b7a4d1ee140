"""What a search is asked: all that came in a stretch of time, as a recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.estimation.incremental.following import Following
from synchronizar.estimation.incremental.range_log import RangeLog
from synchronizar.estimation.incremental.roster import Roster
from synchronizar.estimation.incremental.snapshot import Candidate, SlotPoses, Snapshot
from synchronizar.estimation.incremental.tracking import Tracking
from synchronizar.geometry import apply_frames
from synchronizar.preprocessing.pose_stream import PoseStream
from synchronizar.preprocessing.repaired_poses import Tail
from synchronizar.quaternions import normalized_quaternions

_LONG_AGO = -1e9  # s: a track of one pose there covers no range
_NOWHERE = Track(np.array([_LONG_AGO]), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))


def snapshot_of(
    roster: Roster,
    following: Following,
    log: RangeLog,
    sought: list[int],
    checking: bool,
    candidates: tuple[Candidate, ...],
) -> Snapshot:
    """All that tells where those are who are `sought`; `checking`: they are followed, and looked for all the same."""
    tracking, gauge = following.tracking, following.gauge
    begin = _begin(roster, tracking, sought)
    tracks, segments, rebuilt, poses, first = {}, {}, {}, {}, np.full(len(roster.users), -np.inf)
    clocks = np.array([tracking.run_off(clock) for clock in tracking.read_clock.tolist()])
    # A recording is sorted by name, and users are in the order in which they came.
    users = tuple(replace(roster.as_known(u), name=f"{u:08d}") for u in range(len(roster.users)))
    slots = list(range(tracking.slot_of(begin), tracking.slot_of(roster.now) + 1))
    for u, (user, stream) in enumerate(zip(users, roster.streams, strict=True)):
        if stream is None:
            poses[u] = SlotPoses(slots, np.zeros(len(slots) + 1), np.zeros((len(slots) + 1, 3)))
            continue
        since = roster.standings[u].since
        # Of who is looked for anew only what came since then: before, its SLAM's frame was another one.
        own_begin = begin if checking or u not in sought or since is None else max(begin, since)
        clock = float(tracking.read_clock[u])
        tail = stream.believed(own_begin + clock)
        if not len(tail.t):
            tracks[user.name], segments[user.name] = _NOWHERE, np.zeros(1, dtype=np.int32)
            rebuilt[user.name] = stream.rebuilt_sigma
            first[u] = np.inf
            continue
        tracks[user.name], segments[user.name] = _track_from(stream, own_begin + clock, tail, float(clocks[u]))
        rebuilt[user.name] = stream.rebuilt_sigma
        if own_begin > begin or (u != gauge and u not in tracking.members):
            first[u] = float(tail.t[0]) - clock
        begins = np.array([tracking.begin_of(n) for n in slots]) + clock
        poses[u] = _slot_poses(stream, tail, slots, begins, tracking.slot_of(float(tail.t[0]) - clock))
    rows = log.rows
    rows = rows[np.lexsort([rows[:, -1], rows[:, 0]])]
    a, b = log.users(rows)
    rows = rows[rows[:, 0] > np.maximum(begin, np.maximum(first[a], first[b]))]
    return Snapshot(
        roster.now,
        clocks,
        Recording(users, tracks, log.ranges(rows)),
        rows[:, -1].astype(np.int32),
        segments,
        rebuilt,
        gauge,
        tuple(sought),
        candidates,
        {} if checking else _known(tracking, sought),
        poses,
        tuple(u for u, s in enumerate(roster.standings) if s.is_registered),
        roster.parameters,
    )


def _begin(roster: Roster, tracking: Tracking, sought: list[int]) -> float:
    """s: from when on a search looks at what came."""
    if tracking.members:
        return tracking.begin_of(next(iter(tracking.follower.slots)))
    first = min((s for u in sought if (s := roster.standings[u].since) is not None), default=roster.now)
    return max(first, roster.now - roster.parameters.search.first_stretch)


def _known(tracking: Tracking, sought: list[int]) -> dict[int, Array]:
    """(4,) x, y, z, yaw of who is followed and not sought: a frame from its repaired SLAM's, lengths in m."""
    out = {}
    for u, tracked in tracking.members.items():
        if u not in sought:
            x, y, yaw, height, log_scale = tracked.state[:5].tolist()
            arm = apply_frames(np.array([0.0, 0.0, 0.0, yaw]), np.exp(log_scale) * tracked.place)
            out[u] = np.append(np.array([x, y, height]) - arm, yaw)
    return out


def _slot_poses(stream: PoseStream, tail: Tail, slots: list[int], begins: Array, first: int) -> SlotPoses:
    """Those of `slots` that a device's `tail` covers, by their begins (s, its own clock); `first`: where it begins."""
    known = stream.at(begins)
    there = np.flatnonzero(known.valid & (begins >= tail.t[0]) & (begins <= tail.t[-1]))
    covered, stamps, places = [slots[n] for n in there.tolist()], begins[there], known.position[there]
    if first < covered[0] if covered else first in slots:
        # It comes in the middle of a slot: its first one begins where its poses do.
        covered = [first, *covered]
        stamps, places = np.append(tail.t[0], stamps), np.concatenate([tail.position[:1], places])
    return SlotPoses(covered, np.append(stamps, tail.t[-1]), np.concatenate([places, tail.position[-1:]]))


def _track_from(stream: PoseStream, stamp: float, tail: Tail, clock: float) -> tuple[Track, Indices]:
    """A track from a stamp on, and the segments of its poses; it begins there where the pose is known.

    Its stamps are by a clock that is `clock` (s) behind its own.
    """
    t, position, quat, segment = tail.t, tail.position, tail.quat_xyzw, tail.segment
    first = stream.at(np.array([stamp]))
    if first.valid[0] and t[0] > stamp:
        t, segment = np.append(stamp, t), np.append(segment[0], segment)
        position, quat = np.concatenate([first.position, position]), np.concatenate([first.quat_xyzw, quat])
    return Track(t - clock, position, normalized_quaternions(quat)), segment
