"""Time to registration and accuracy of replays, of simulated walks and real recordings.

`python -m experiments.live.replays [--walks 60] [--recordings ../shared/recordings] [--long 10] [--users 2 4]`.

Free walks of 20 s (sigma 0.1 m, every pair at 1000 / (80 + 21 (k - 1)) Hz, nothing wrong with anybody's device) are
replayed: when each user is first registered, and the error of its place (in the plane, against the truth, beside
the reference) whenever it is; and when 95 % of all placements are within 0.15 m of the truth
in the plane, beside when those of maximum likelihood are, which starts at the truth and trusts SLAM. Recordings: when
users were registered, the error of their causal tracks beside the reference's after the first minute, and how far the
place at the end is from that of `register`. `--long` minutes: how long updates take, and how much memory.
"""

from __future__ import annotations

import argparse
import resource
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from experiments.common.full_oracle import common_from_world
from experiments.common.results import write_table
from experiments.common.walks import on_all_cores, oracle
from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.data.updates import Replay
from synchronizar.estimation.incremental.engine import Engine
from synchronizar.estimation.incremental.replay import A_SECOND, in_time, replay
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame
from synchronizar.parameters import Parameters
from synchronizar.reporting.evaluate import align, match, read_tracks
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

SECONDS = 20.0
MINUTE = 60.0
OFF = 0.6
WITHIN = 10.0
PLACED, SHARE = 0.15, 0.95
MOMENTS = np.arange(3.0, SECONDS, 0.5)


class Walk(NamedTuple):
    """One free walk."""

    first: list[float]
    """s, when each user was first registered; infinity for never."""
    wrong: int
    """How many users were registered at some time while off by more than 0.6 m."""
    errors: list[float]
    """m in the plane, of each user at the end."""
    off: Array
    """(moments, k - 1) m in the plane, of each user's frame; infinity before it has one."""
    best: Array
    """(moments, k - 1) the same of maximum likelihood on the ranges until then."""
    seconds: list[float]
    """How long each update took."""


def walk(scene: Scene) -> Walk:
    """Replay one."""
    simulation = simulate(scene)
    recording = simulation.recording
    played = replay(recording)
    reference = played.registration.reference
    to_common = common_from_world(simulation, reference)
    began, first, wrong, errors = _began(recording), [], 0, []
    best = np.array([_best(simulation, reference, began + t) for t in MOMENTS.tolist()])
    until = np.searchsorted([u.t - began for u in played.updates], MOMENTS, side="right") - 1
    off_by_user = []
    for user in recording.users:
        if user.name == reference:
            continue
        true = to_common @ simulation.world_from_user[user.name]
        told = [(u.t - began, u.users[user.name]) for u in played.updates]
        registered = [(t, of) for t, of in told if of.state is State.REGISTERED]
        first.append(registered[0][0] if registered else np.inf)
        off = np.array([_off(of.common_from_user, true) for _, of in told])
        errors.append(float(off[-1]))
        off_by_user.append(off[until])
        wrong += any(_off(of.common_from_user, true) > OFF for _, of in registered)
    return Walk(first, wrong, errors, np.array(off_by_user).T, best, [u.seconds for u in played.updates])


def _off(found: YawFrame | None, true: YawFrame) -> float:
    return np.inf if found is None else float(np.hypot(*(found.translation - true.translation)[:2]))


def _best(simulation: Simulation, reference: str, until: float) -> Array:
    """(k - 1,) m."""
    kept = simulation.recording.ranges.t <= until
    recording = replace(simulation.recording, ranges=simulation.recording.ranges.select(kept))
    part = replace(simulation, recording=recording, late=simulation.late[kept], extra=simulation.extra[kept])
    error = np.delete(oracle(part, reference, Parameters()).error, recording.index(reference), axis=0)
    return np.asarray(np.hypot(error[:, 0], error[:, 1]))


def _placed_after(off: list[Array]) -> float:
    """Seconds until `SHARE` of all users are within `PLACED`, and remain so."""
    near = np.quantile(np.concatenate(off, axis=1), SHARE, axis=1, method="higher") < PLACED
    late = np.flatnonzero(~near)
    return float(np.append(MOMENTS, np.inf)[late[-1] + 1 if len(late) else 0])


def walks_row(users: int, walks: list[Walk]) -> dict[str, Any]:
    """A line of the table."""
    first = np.concatenate([w.first for w in walks])
    seconds = np.concatenate([w.seconds for w in walks])
    return {
        "users": users,
        "n": len(first),
        "median s until registered": float(np.median(first)),
        "95th percentile": float(np.quantile(first, 0.95, method="higher")),
        "registered by 10 s": float((first <= WITHIN).mean()),
        "ever registered and off > 0.6 m": sum(w.wrong for w in walks),
        f"s until {SHARE:.0%} within {PLACED} m": _placed_after([w.off for w in walks]),
        "of maximum likelihood": _placed_after([w.best for w in walks]),
        "median error at the end": float(np.median(np.concatenate([w.errors for w in walks]))),
        **_times(seconds),
    }


def recording_row(folder: Path) -> dict[str, Any]:
    """A line of the table."""
    recording, truth = Recording.load(folder), read_tracks(folder / "truth")
    played, whole = replay(recording), register(recording)
    reference, began = played.registration.reference, _began(recording)
    others = [user.name for user in recording.users if user.name != reference]
    first = [_first(played, name, began) for name in others]
    away = [
        float(np.linalg.norm((a.translation - b.translation)[:2]))
        for name in others
        if (a := played.registration.users[name].common_from_user) and (b := whole.users[name].common_from_user)
    ]
    registered = [f for f in first if np.isfinite(f)]
    return {
        "recording": folder.name,
        "users": len(recording.users),
        "ever registered": f"{len(registered)} of {len(others)}",
        "median s until registered": float(np.median(registered)) if registered else None,
        "causal transfer xy after 60 s": _causal(played, truth, reference, others, began + MINUTE),
        "largest distance of the end to batch": max(away, default=None),
        **_times(np.array([u.seconds for u in played.updates])),
    }


def _first(played: Replay, name: str, began: float) -> float:
    return next((u.t - began for u in played.updates if u.users[name].state is State.REGISTERED), np.inf)


def _causal(played: Replay, truth: dict[str, Any], reference: str, others: list[str], since: float) -> float | None:
    """RMSE (m) in the plane of all others, the reference's own track aligned with its truth; both from then on."""
    if reference not in truth or reference not in played.tracks:
        return None
    own = played.tracks[reference]
    late = own.t > since
    if not late.any():
        return None
    laid = match(Track(own.t[late], own.position[late], own.quat_xyzw[late]), truth[reference])
    if laid is None:
        return None
    squares = []
    for name in others:
        track = played.tracks.get(name)
        if track is None or name not in truth or track.t[-1] <= since:
            continue
        matched = match(track, truth[name])
        known = track.t[truth[name].at(track.t, 0.5).valid]
        if matched is not None:
            off = align([laid]) @ matched.estimated - matched.true
            squares.append((off[known > since, :2] ** 2).sum(axis=1))
    return float(np.sqrt(np.concatenate(squares).mean())) if squares else None


def long_row(users: int, minutes: float) -> dict[str, Any]:
    """All pairs at 8 Hz, tracks at 30 Hz, ten updates a second; nothing is kept of what was told."""
    scene = Scene(users=users, seconds=60.0 * minutes, rate_hz=8.0, drift_m_per_sqrt_s=0.01)
    recording = simulate(scene).recording
    names, ranges = [user.name for user in recording.users], recording.ranges
    engine = Engine(recording.users, names[0])
    seconds, most = [], []
    for t, user, row in in_time(recording):
        if t >= (len(seconds) + 1) / A_SECOND:
            began = perf_counter()
            engine.advance(t)
            seconds.append(perf_counter() - began)
            most.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
        if user >= 0:
            track = recording.tracks[names[user]]
            engine.add_pose(names[user], t, track.position[row], track.quat_xyzw[row])
        else:
            engine.add_range(t, names[ranges.a[row]], names[ranges.b[row]], float(ranges.distance[row]))
    quarters = [float(q.sum()) for q in np.array_split(np.array(seconds), 4)]
    return {
        "users": users,
        "minutes": minutes,
        **_times(np.array(seconds)),
        "times real time": 60.0 * minutes / sum(quarters),
        "last quarter / second": quarters[3] / quarters[1],
        **{f"GB, quarter {n + 1}": float(of[-1]) for n, of in enumerate(np.array_split(np.array(most), 4))},
        "registered": sum(engine.is_registered(u) for u in range(users)),
    }


def _times(seconds: np.ndarray) -> dict[str, float]:
    p50, p99 = (1e3 * np.quantile(seconds, q) for q in (0.5, 0.99))
    return {"p50 ms": float(p50), "p99 ms": float(p99), "max ms": float(1e3 * seconds.max())}


def _began(recording: Recording) -> float:
    return float(recording.ranges.t.min())


def main() -> None:
    """The tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--walks", type=int, default=60)
    parser.add_argument("--users", type=int, nargs="+", default=[2, 4])
    parser.add_argument("--recordings", type=Path)
    parser.add_argument("--long", type=float)
    options = parser.parse_args()
    settings = {**vars(options), "recordings": str(options.recordings)}
    if options.walks:
        rows = []
        for users in options.users:
            scenes = [Scene(users=users, seconds=SECONDS, seed=seed) for seed in range(options.walks)]
            rows.append(walks_row(users, list(on_all_cores(walk, scenes))))
        print(write_table("replays_walks", rows, settings))
    if options.recordings is not None:
        folders = sorted(f.parent for f in options.recordings.glob("*/ranges.csv"))
        print(write_table("replays_recordings", [recording_row(folder) for folder in folders], settings))
    if options.long:
        rows = [long_row(users, options.long) for users in options.users]
        print(write_table("replays_long", rows, settings))


if __name__ == "__main__":
    main()
