"""Time to registration of users who follow cues, against free walks and walks side by side.

`python -m experiments.live.cues [--seeds 60]`: two people, ranges with 0.1 m at the paper's rate, nothing wrong with
their devices. The first walks freely from place to place of a room of 6 m; the second walks freely too, or beside the
first (1 m to its left), or as the cues say: at most once a second it takes the sentence that there is by its words (to
its left, towards somebody) and walks that way, as far as walls let it. They
begin anywhere, or 1 m apart, as those who walk side by side do: who is near is placed sooner. The walk goes on until it
is registered, for 30 s at most. The figure draws who is registered when.
"""

from __future__ import annotations

import argparse
import re
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

import synchronizar as sz
from experiments.common.live import is_registered
from experiments.common.results import FOLDER, write_table
from experiments.common.walks import on_all_cores
from synchronizar.arrays import Array
from synchronizar.data.ranging_rate import papers_rate_hz
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.quaternions import yaw_quaternion

WAYS = {
    "free": "-C0",
    "cues": "--C1",
    "free, from 1 m apart": "-C2",
    "cues, from 1 m apart": "--C3",
    "side by side": ":C4",
}
"""And how they are drawn."""
AREA_M, SPEED_M_S, BESIDE_M = 6.0, 1.0, 1.0
TURN_RAD_S = 3.0
HEIGHT_M, HEIGHT_SPREAD_M = 1.4, 0.1
POSES_HZ, UPDATES_HZ = 30, 10
RANGES_HZ = papers_rate_hz(partners=1)
SIGMA_M = 0.1
ARRIVED_M = 0.1
LISTENS_S = 1.0
LONGEST_S = 30.0
REFERENCE, OTHER = 0, 1
TURNS = {
    "straight on": 0.0,
    "ahead to your left": 45.0,
    "to your left": 90.0,
    "back to your left": 135.0,
    "back": 180.0,
    "ahead to your right": -45.0,
    "to your right": -90.0,
    "back to your right": -135.0,
}
"""Degrees, from where somebody walks."""
BY_SOMEBODY = {
    "towards ": 0.0,
    "away from ": 180.0,
    "to the left, as you look at ": 90.0,
    "to the right, as you look at ": -90.0,
}
"""Degrees, from where the other is."""


class Walked(NamedTuple):
    """One walk."""

    way: str
    seconds: float
    """Until it was registered; infinity for never."""
    off: float
    """m: how far its place was off then."""


class Walker:
    """Somebody who walks straight from place to place."""

    def __init__(self, random: np.random.Generator) -> None:
        self.random = random
        self.place = np.append(self.anywhere(), HEIGHT_M + HEIGHT_SPREAD_M * random.standard_normal())
        self.target = self.anywhere()
        self.heading = 0.0
        start = self.place.tolist()
        self.world_from_user = YawFrame(*start, yaw=float(random.uniform(-np.pi, np.pi)))

    def anywhere(self) -> Array:
        """(2,) m: in the room."""
        return np.asarray(self.random.uniform(-0.5, 0.5, 2) * AREA_M)

    def step(self, seconds: float) -> None:
        """Walk on."""
        to = self.target - self.place[:2]
        if np.linalg.norm(to) < ARRIVED_M:
            self.target = self.anywhere()
            to = self.target - self.place[:2]
        most = TURN_RAD_S * seconds
        self.heading += float(np.clip(wrap_angle(float(np.arctan2(to[1], to[0])) - self.heading), -most, most))
        length = float(np.linalg.norm(to))
        self.place[:2] += min(SPEED_M_S * seconds, length) / length * to

    def goes(self, way: float, length: float) -> None:
        """From here in a direction (rad, in the room), as far as the walls let it."""
        ahead = self.place[:2] + length * np.array([np.cos(way), np.sin(way)])
        self.target = np.clip(ahead, -0.5 * AREA_M, 0.5 * AREA_M)

    def pose(self) -> tuple[Array, Array]:
        """As SLAM has it: (3,) and (4,)."""
        own = self.world_from_user.inverse() @ self.place
        return own, yaw_quaternion(self.heading - self.world_from_user.yaw)


def walk(task: tuple[str, int]) -> Walked:
    """Until the second is registered."""
    way, seed = task
    people, radio = np.random.default_rng(seed).spawn(2)
    walkers = [Walker(r) for r in people.spawn(2)]
    if way not in ("free", "cues"):
        _beside(walkers)
        walkers[OTHER].world_from_user = YawFrame(
            *walkers[OTHER].place.tolist(), yaw=walkers[OTHER].world_from_user.yaw
        )
    names = ("phone0", "phone1")
    estimator = sz.Estimator(names, reference=names[REFERENCE], workers=0)
    ranged, heard = 0.0, -np.inf
    for n in range(int(LONGEST_S * POSES_HZ)):
        t = n / POSES_HZ
        for walker in walkers:
            walker.step(1.0 / POSES_HZ)
        if way == "side by side":
            _beside(walkers)
        for name, walker in zip(names, walkers, strict=True):
            estimator.add_pose(name, t, *walker.pose())
        if t >= ranged:
            ranged += 1.0 / RANGES_HZ
            distance = float(np.linalg.norm(walkers[0].place - walkers[1].place) + SIGMA_M * radio.standard_normal())
            if distance > 0.0:
                estimator.add_range(t, *names, distance)
        if n % (POSES_HZ // UPDATES_HZ):
            continue
        estimator.advance(t)
        told = estimator.registration().users[names[OTHER]]
        if is_registered(told):
            assert told.common_from_user is not None
            return Walked(way, t, _off(told.common_from_user, walkers))
        if way.startswith("cues") and told.cue is not None and t > heard + LISTENS_S:
            heard = t
            walkers[OTHER].goes(*understood(told.cue, walkers[OTHER].heading, _way(walkers)))
    return Walked(way, np.inf, np.nan)


def _beside(walkers: list[Walker]) -> None:
    first, second = walkers
    left = first.heading + 0.5 * np.pi
    second.place[:2] = first.place[:2] + BESIDE_M * np.array([np.cos(left), np.sin(left)])
    second.heading = first.heading


def _way(walkers: list[Walker]) -> float:
    """Which way (rad, in the room) the first is from the second."""
    to = walkers[REFERENCE].place - walkers[OTHER].place
    return float(np.arctan2(to[1], to[0]))


def understood(cue: str, heading: float, towards: float) -> tuple[float, float]:
    """Which way (rad, in the room) a cue sends somebody who walks towards `heading`, and how far (m).

    `towards`: which way the other is. Raises ValueError for words that nobody would know what to do with.
    """
    found = re.match(r"walk (?P<length>[\d.]+) m (?P<way>.+)", cue)
    if found is None:
        raise ValueError(f"no cue: {cue!r}")
    length, way = float(found["length"]), found["way"]
    for words, degrees in TURNS.items():
        if way == words:
            return heading + np.radians(degrees), length
    for words, degrees in BY_SOMEBODY.items():
        if way.startswith(words):
            return towards + np.radians(degrees), length
    raise ValueError(f"no way to go: {cue!r}")


def _off(frame: YawFrame, walkers: list[Walker]) -> float:
    """m, in the plane: the place of the second as the first sees it."""
    found = frame @ walkers[OTHER].pose()[0]
    true = walkers[REFERENCE].world_from_user.inverse() @ walkers[OTHER].place
    return float(np.linalg.norm((found - true)[:2]))


def main() -> None:
    """The table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=60)
    options = parser.parse_args()
    walked = list(on_all_cores(walk, [(way, seed) for way in WAYS for seed in range(options.seeds)]))
    print(write_table("cues", [_row(way, [w for w in walked if w.way == way]) for way in WAYS], vars(options)))
    _draw(walked)


def _row(way: str, walked: list[Walked]) -> dict[str, Any]:
    seconds = np.array([w.seconds for w in walked])
    return {
        "way": way,
        "n": len(walked),
        "median s until registered": float(np.median(seconds)),
        "95th percentile": float(np.quantile(seconds, 0.95, method="higher")),
        "by 7 s": float((seconds <= 7.0).mean()),
        "by 10 s": float((seconds <= 10.0).mean()),
        "largest off then, m": float(np.nanmax([w.off for w in walked])),
    }


def _draw(walked: list[Walked]) -> None:
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    ax = figure.add_subplot()
    for way, style in WAYS.items():
        seconds = np.sort([w.seconds for w in walked if w.way == way])
        share = np.arange(1, len(seconds) + 1) / len(seconds)
        known = np.isfinite(seconds)
        ax.step(np.append(0.0, seconds[known]), np.append(0.0, share[known]), style, where="post", label=way)
    ax.set(xlabel="time since the first range (s)", ylabel="share that is registered", ylim=(0.0, 1.0))
    ax.set_xlim(left=0.0)
    ax.legend(title="how the second walks")
    ax.grid(alpha=0.3)
    FOLDER.mkdir(exist_ok=True)
    figure.savefig(FOLDER / "cues.png", dpi=150)


if __name__ == "__main__":
    main()
