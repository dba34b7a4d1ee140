"""False registrations while people walk: how often a user called `registered` is off.

`python -m experiments.live.replay_verdicts [--scenes 1000] [--first-seed 0] [--out FILE] [--processes 2]` feeds the
scenes of `experiments.accuracy.verdicts`, the hard ones too, to an `Estimator`; in every other one SLAM drifts and has
a wrong scale, clocks are off and radios biased. An episode is a stretch of updates in which a user is called
registered; it is wrong where at any time in it the user's place is off by more than 0.6 m (in three dimensions, where
it is then), or its frame, in x, y, z or yaw, by more than 5 of its own standard deviations. The share of wrong ones has
the upper end of its one-sided 95 % interval (Clopper and Pearson 1934) beside it. `--out` gets a line for each scene as
soon as it is done; scenes that it has are not done again, and the table is of all that it has: a thousand scenes may be
done in parts (by one and the same estimator: nothing checks that).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from dataclasses import replace
from multiprocessing import Pool
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from experiments.accuracy.verdicts import KINDS, OFF, scene_of
from experiments.common.full_oracle import common_from_world, true_frames_along
from experiments.common.live import Said, Told, arrival_of, estimator_of, fed, told
from experiments.common.results import write_table
from synchronizar.arrays import Array, Mask
from synchronizar.geometry import apply_frames, difference
from synchronizar.simulation.simulate import Simulation, simulate

SIGMAS = 5.0
CONFIDENCE = 0.95
FAULTS: dict[str, Any] = {
    "drift_m_per_sqrt_s": 0.02,
    "drift_rad_per_sqrt_s": 0.01,
    "scale_sigma": 0.05,
    "bias_sigma": 0.05,
    "clock_offset_sigma": 0.05,
}


class Episode(NamedTuple):
    """One stretch in which a user was called registered."""

    kind: str
    seed: int
    user: str
    begin: float
    """s since the first range."""
    off: float
    """m, at most."""
    sigmas: float
    """At most."""

    @property
    def wrong(self) -> bool:
        """Whether it should not have been called so."""
        return self.off > OFF or self.sigmas > SIGMAS


class Judged(NamedTuple):
    """A scene that is done."""

    kind: str
    seed: int
    cpu: float
    """s."""
    episodes: list[Episode]


def judge(seed: int) -> Judged:
    """One scene."""
    began = process_time()
    kind, scene = scene_of(seed)
    if seed % 2:
        scene = replace(scene, **FAULTS)
    simulation = simulate(scene)
    recording = simulation.recording
    estimator = estimator_of(recording)
    of = told(recording, fed(recording, estimator), estimator)
    found = []
    for user in recording.users:
        if user.name == of.reference or of.reference is None:
            continue
        off, sigmas = _errors(simulation, of, of.reference, user.name)
        for stretch in stretches(of.users[user.name].registered):
            begin = float(of.t[stretch.start] - recording.ranges.t.min())
            found.append(Episode(kind, seed, user.name, begin, float(off[stretch].max()), float(sigmas[stretch].max())))
    return Judged(kind, seed, process_time() - began, found)


def stretches(registered: Mask) -> list[slice]:
    """Of updates one after the other in which a user was registered."""
    edges = np.diff(registered.astype(int), prepend=0, append=0)
    begins, ends = np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist()
    return [slice(begin, end) for begin, end in zip(begins, ends, strict=True)]


def _errors(simulation: Simulation, of: Told, reference: str, name: str) -> tuple[Array, Array]:
    """(m,) m: how far off a device is at each update, and (m,) its frame in sigmas."""
    said, track = of.users[name], simulation.recording.tracks.get(name)
    if track is None:
        place = (common_from_world(simulation, reference) @ simulation.world_from_user[name]).translation
        frames, here = np.append(place, 0.0)[None], np.zeros((1, 3))
        true = place[None]
    else:
        last = np.maximum(np.searchsorted(arrival_of(track), of.t) - 1, 0)
        frames, here = true_frames_along(simulation, reference, name)[last], track.position[last]
        true = apply_frames(frames, simulation.world_from_user[name].scale * here)
    placed = apply_frames(said.frame[:, :4], said.frame[:, 4:] * here)
    return np.linalg.norm(placed - true, axis=1), in_sigmas(said, frames)


def in_sigmas(said: Said, frames: Array) -> Array:
    """(m,) the largest error of x, y, z and yaw in units of what is said of it; 0 where nothing is said."""
    sigma = np.sqrt(np.diagonal(said.covariance, axis1=1, axis2=2))
    error = np.abs(difference(said.frame[:, :4], np.broadcast_to(frames, (len(sigma), 4)).copy()))
    known = np.isfinite(sigma) & np.isfinite(error)
    return np.asarray(np.divide(error, sigma, out=np.zeros_like(error), where=known).max(axis=1))


def upper_bound(wrong: int, n: int) -> float:
    """The largest share that so many wrong ones of n, or fewer, would still come of in 5 % of all cases."""
    from scipy.stats import beta

    return 1.0 if wrong >= n else float(beta.ppf(CONFIDENCE, wrong + 1, n - wrong))


def line_of(judged: Judged) -> str:
    """For the file: an episode is a list of all that the scene does not say."""
    fields = {**judged._asdict(), "episodes": [list(e[2:]) for e in judged.episodes]}
    return json.dumps(fields) + "\n"


def judged_of(line: str) -> Judged:
    """The same scene again."""
    fields = json.loads(line)
    episodes = [Episode(fields["kind"], fields["seed"], *rest) for rest in fields.pop("episodes")]
    return Judged(**fields, episodes=episodes)


def all_of(seeds: Iterable[int], file: Path | None, processes: int | None) -> list[Judged]:
    """Scenes, done now or before, and whatever else the file has."""
    lines = file.read_text(encoding="utf-8").splitlines() if file is not None and file.exists() else []
    done = {judged.seed: judged for judged in map(judged_of, lines)}
    left = [seed for seed in seeds if seed not in done]
    with Pool(processes) as pool:
        for judged in pool.imap_unordered(judge, left):
            if file is not None:
                with file.open("a", encoding="utf-8") as out:
                    out.write(line_of(judged))
            done[judged.seed] = judged
    return [done[seed] for seed in sorted(done)]


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=1000)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--processes", type=int)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.scenes)
    scenes = all_of(seeds, options.out, options.processes)
    groups = {kind: [s for s in scenes if s.kind == kind] for kind in KINDS}
    groups |= {"devices right": [s for s in scenes if s.seed % 2 == 0]}
    groups |= {"devices wrong": [s for s in scenes if s.seed % 2], "all": scenes}
    rows = [_row(name, of_group) for name, of_group in groups.items()]
    print(write_table("replay_verdicts", rows, {**vars(options), "out": str(options.out)}))
    for e in (e for s in scenes for e in s.episodes if e.wrong):
        print(f"{e.kind} scene {e.seed}, {e.user}, since {e.begin:.1f} s: {e.off:.2f} m, {e.sigmas:.1f} sigmas")


def _row(group: str, scenes: list[Judged]) -> dict[str, Any]:
    mine = [e for s in scenes for e in s.episodes]
    wrong = sum(e.wrong for e in mine)
    return {
        "scenes": group,
        "n": len(scenes),
        "with any": len({e.seed for e in mine}),
        "episodes": len(mine),
        f"off > {OFF} m": sum(e.off > OFF for e in mine),
        f"off > {SIGMAS:g} sigma": sum(e.sigmas > SIGMAS for e in mine),
        "wrong": wrong,
        "share": wrong / max(len(mine), 1),
        "at most (95 %)": upper_bound(wrong, len(mine)),
        "CPU s a scene": sum(s.cpu for s in scenes) / max(len(scenes), 1),
    }


if __name__ == "__main__":
    main()
