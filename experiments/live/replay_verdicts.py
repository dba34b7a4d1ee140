"""False registrations while people walk: how often a user called `registered` is off.

`python -m experiments.live.replay_verdicts [--scenes 1000]` replays the scenes of `experiments.accuracy.verdicts`, the
hard ones too; in every other one SLAM drifts and has a wrong scale, clocks are off and radios biased. An episode is a
stretch of updates in which a user is called registered; it is wrong where at any time in it the user's place is off by
more than 0.6 m (in three dimensions, where it is then), or its frame, in x, y, z or yaw, by more than 5 of its own
standard deviations. The share of wrong ones has the upper end of its one-sided 95 % interval (Clopper and Pearson 1934)
beside it.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from experiments.accuracy.verdicts import KINDS, OFF, scene_of
from experiments.common.full_oracle import common_from_world
from experiments.common.results import write_table
from experiments.common.walks import on_all_cores
from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.data.updates import UserUpdate
from synchronizar.estimation.incremental.replay import replay
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.simulation.simulate import simulate

SIGMAS = 5.0
CONFIDENCE = 0.95
RADIO = np.zeros(3)
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


def episodes(seed: int) -> list[Episode]:
    """Those of one scene."""
    kind, scene = scene_of(seed)
    if seed % 2:
        scene = replace(scene, **FAULTS)
    simulation = simulate(scene)
    recording = simulation.recording
    played = replay(recording)
    reference = played.registration.reference
    to_common = common_from_world(simulation, reference)
    out: list[Episode] = []
    for name in recording.tracks.keys() | {u.name for u in recording.users if u.static}:
        if name == reference:
            continue
        true = to_common @ simulation.world_from_user[name]
        before = False
        for update in played.updates:
            user = update.users[name]
            now = user.state is State.REGISTERED and user.common_from_user is not None
            if now:
                track = recording.tracks.get(name)
                here = RADIO if track is None else track.at(np.array([update.t]), np.inf).position[0]
                off, sigmas = _errors(user, true, here)
                if before:
                    last = out[-1]
                    out[-1] = last._replace(off=max(last.off, off), sigmas=max(last.sigmas, sigmas))
                else:
                    out.append(Episode(kind, seed, name, update.t - recording.ranges.t.min(), off, sigmas))
            before = now
    return out


def _errors(user: UserUpdate, true: YawFrame, here: Array) -> tuple[float, float]:
    """How far off (m) a device at `here` (3,) of its own frame is, and its frame in sigmas."""
    frame = user.common_from_user
    assert frame is not None
    off = float(np.linalg.norm(frame @ here - true @ here))
    error = np.append(frame.translation - true.translation, wrap_angle(frame.yaw - true.yaw))
    if user.covariance is None:
        return off, 0.0
    sigma = np.sqrt(np.diag(user.covariance))
    known = np.isfinite(sigma)
    return off, float(np.abs(error[known] / sigma[known]).max())


def upper_bound(wrong: int, n: int) -> float:
    """The largest share that so many wrong ones of n, or fewer, would still come of in 5 % of all cases."""
    from scipy.stats import beta

    return 1.0 if wrong >= n else float(beta.ppf(CONFIDENCE, wrong + 1, n - wrong))


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=1000)
    options = parser.parse_args()
    found = [e for of_scene in on_all_cores(episodes, range(options.scenes)) for e in of_scene]
    groups = {kind: [e for e in found if e.kind == kind] for kind in KINDS}
    groups |= {
        "devices right": [e for e in found if e.seed % 2 == 0],
        "devices wrong": [e for e in found if e.seed % 2],
    }
    groups["all"] = found
    print(write_table("replay_verdicts", [_row(name, of_group) for name, of_group in groups.items()], vars(options)))
    for e in found:
        if e.wrong:
            print(f"{e.kind} scene {e.seed}, {e.user}, since {e.begin:.1f} s: {e.off:.2f} m, {e.sigmas:.1f} sigmas")


def _row(group: str, mine: list[Episode]) -> dict[str, Any]:
    wrong = sum(e.wrong for e in mine)
    return {
        "scenes": group,
        "with any": len({e.seed for e in mine}),
        "episodes": len(mine),
        f"off > {OFF} m": sum(e.off > OFF for e in mine),
        f"off > {SIGMAS:g} sigma": sum(e.sigmas > SIGMAS for e in mine),
        "wrong": wrong,
        "share": wrong / max(len(mine), 1),
        "at most (95 %)": upper_bound(wrong, len(mine)),
    }


if __name__ == "__main__":
    main()
