"""Time to registration and accuracy while people walk, of simulated walks and real recordings.

`python -m experiments.live.replays [--walks 60] [--users 2 4] [--recordings ../shared/recordings] [--since 60]
[--real-time]`.

Free walks of 20 s (sigma 0.1 m, every pair at 1000 / (80 + 21 (k - 1)) Hz, nothing wrong with anybody's device) are fed
to an `Estimator`: when each user is first registered, and the error of its place (in the plane, against the truth,
beside the reference) whenever it is; and when 95 % of all placements are within 0.15 m of the truth in the plane,
beside when those of maximum likelihood are, which starts at the truth and trusts SLAM. Recordings: when users were
registered; from `--since` seconds on, the error in the plane of poses and radios' places as they were told, beside the
reference's, and the least share of that time for which one of those with truth was registered; and how far the place at
the end is from that of `register`. `--real-time` feeds recordings by the wall clock, with the worker that there is by
default: how long updates take for who watches, and how far the wall clock is ahead of the data at most.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.common.full_oracle import common_from_world
from experiments.common.live import OFF, Told, estimator_of, fed, first_registered, told, written
from experiments.common.results import write_table
from experiments.common.walks import on_all_cores, oracle
from synchronizar.arrays import Array, Mask
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame
from synchronizar.parameters import Parameters
from synchronizar.reporting.evaluate import MAX_GAP_S, Matched, align, read_tracks
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

SECONDS = 20.0
MINUTE = 60.0
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
    seconds: Array
    """(m,) how long each update took."""


def walk(scene: Scene) -> Walk:
    """Follow one."""
    simulation = simulate(scene)
    recording = simulation.recording
    estimator = estimator_of(recording)
    of = told(recording, fed(recording, estimator), estimator)
    assert of.reference is not None
    to_common = common_from_world(simulation, of.reference)
    began = float(recording.ranges.t.min())
    best = np.array([_best(simulation, of.reference, began + t) for t in MOMENTS.tolist()])
    until = np.searchsorted(of.t - began, MOMENTS + 1e-6, side="right") - 1
    others = [user.name for user in recording.users if user.name != of.reference]
    off = np.array([_off(of.users[name].frame, to_common @ simulation.world_from_user[name]) for name in others])
    registered = np.array([of.users[name].registered for name in others])
    wrong = int((registered & (off > OFF)).any(axis=1).sum())
    first = [first_registered(of, name) for name in others]
    return Walk(first, wrong, off[:, -1].tolist(), off[:, until].T, best, of.wall)


def _off(frame: Array, true: YawFrame) -> Array:
    """(m,) m in the plane; infinite where there is no frame."""
    away = np.hypot(*(frame[:, :2] - true.translation[:2]).T)
    return np.where(np.isfinite(away), away, np.inf)


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


def recording_row(folder: Path, since: float, real_time: bool) -> dict[str, Any]:
    """A line of the table."""
    recording, truth = Recording.load(folder), read_tracks(folder / "truth")
    whole = register(recording)
    estimator = estimator_of(recording, whole.reference, workers=None if real_time else 0)
    of = told(recording, fed(recording, estimator, real_time=real_time), estimator)
    estimator.close()
    others = [user.name for user in recording.users if user.name != whole.reference]
    first = [f for name in others if np.isfinite(f := first_registered(of, name))]
    away = [
        float(np.hypot(*(of.users[name].frame[-1, :2] - frame.translation[:2])))
        for name in others
        if (frame := whole.users[name].common_from_user) is not None
    ]
    began = float(recording.ranges.t.min())
    return {
        "recording": folder.name,
        "users": len(recording.users),
        "ever registered": f"{len(first)} of {len(others)}",
        "median s until registered": float(np.median(first)) if first else None,
        **causal(recording, truth, of, whole.reference, began + since),
        "largest distance of the end to batch": max((a for a in away if np.isfinite(a)), default=None),
        **_times(of.wall),
        **({"s behind, longest": float(of.behind.max())} if real_time else {}),
    }


def causal(
    recording: Recording, truth: dict[str, Track], of: Told, reference: str | None, since: float
) -> dict[str, Any]:
    """RMSE (m) in the plane of all others, the reference's own poses laid onto their truth; all from then on."""
    error, covered = "causal transfer xy", "least share of it registered"
    nothing: dict[str, Any] = {error: None, covered: None}
    if reference is None or reference not in truth:
        return nothing
    estimated, true, there = _told_places(recording, truth[reference], of, reference, since)
    if not there.any():
        return nothing
    aligned = align([Matched(estimated[there], true[there])])
    squares, shares = [], []
    for name in sorted(truth.keys() & of.users.keys() - {reference}):
        estimated, true, there = _told_places(recording, truth[name], of, name, since)
        if len(there):
            shares.append(float(there.mean()))
            squares.append(((aligned @ estimated[there] - true[there])[:, :2] ** 2).sum(axis=1))
    if not squares:
        return nothing
    joined = np.concatenate(squares)
    return {error: float(np.sqrt(joined.mean())) if len(joined) else None, covered: min(shares)}


def _told_places(recording: Recording, truth: Track, of: Told, name: str, since: float) -> tuple[Array, Array, Mask]:
    """(n, 3) m as told, (n, 3) as it was, and whether it was registered: poses (a radio: updates) that truth covers."""
    if name not in recording.tracks:
        late, said = of.t > since, of.users[name]
        place = said.frame[late, :3]
        return place, np.broadcast_to(truth.position[0], place.shape), said.registered[late]
    track = recording.tracks[name]
    poses, true = written(of, track, name), truth.at(track.t, MAX_GAP_S)
    which = true.valid & (poses.t > since) & (poses.t <= of.t[-1])
    return poses.position[which], true.position[which], poses.registered[which]


def _times(seconds: np.ndarray) -> dict[str, float]:
    p50, p99 = (1e3 * np.quantile(seconds, q) for q in (0.5, 0.99))
    return {"p50 ms": float(p50), "p99 ms": float(p99), "max ms": float(1e3 * seconds.max())}


def main() -> None:
    """The tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--walks", type=int, default=60)
    parser.add_argument("--users", type=int, nargs="+", default=[2, 4])
    parser.add_argument("--recordings", type=Path)
    parser.add_argument("--since", type=float, default=MINUTE)
    parser.add_argument("--real-time", action="store_true")
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
        rows = [recording_row(folder, options.since, options.real_time) for folder in folders]
        print(write_table("replays_real_time" if options.real_time else "replays_recordings", rows, settings))


if __name__ == "__main__":
    main()
