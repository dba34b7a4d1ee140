"""The families of scenes: what is drawn of each, from a seed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from experiments.accuracy.full_walks import WRONG
from experiments.common.side_by_side import side_by_side
from experiments.integrity import faults
from experiments.integrity.faults import Fault, Random
from experiments.integrity.trial import Trial
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

BASES = {"build": 1_000_000, "judge": 7_000_000}
"""The first seed of those that are looked at while building, and of those that are not."""
KIM_M, KIM_RAD = 0.02, 0.01
"""Per root second: how ARKit drifts (Kim et al., Sensors 22(24), 2022)."""
PEOPLE = (2, 6)
SECONDS = (8.0, 12.0, 20.0)
MIXTURE, ABREAST = "mixture", "side by side"


class Kind(NamedTuple):
    """Something that is the matter with a scene."""

    scene: Callable[[Random], dict[str, Any]] = lambda _: {}
    """Settings of the simulation."""
    fault: Fault | None = None
    """What is done to the walk afterwards."""


def _set(**settings: Any) -> Callable[[Random], dict[str, Any]]:
    return lambda _: settings


def _late(share: float) -> Callable[[Random], dict[str, Any]]:
    def settings(random: Random) -> dict[str, Any]:
        mean, power = float(random.choice([0.5, 1.0, 2.0])), bool(random.random() < 0.3)
        return {"late_share": share, "late_mean": mean, "power": power}

    return settings


def _bursts(random: Random) -> dict[str, Any]:
    burst, mean = float(random.uniform(4.0, 10.0)), float(random.choice([0.5, 1.0, 2.0]))
    return {"late_share": 0.3, "late_burst_s": burst, "late_mean": mean, "seconds": 20.0}


def _drift(random: Random) -> dict[str, Any]:
    twice = {"drift_m_per_sqrt_s": 2.0 * KIM_M, "drift_rad_per_sqrt_s": 2.0 * KIM_RAD}
    return twice | {"seconds": float(random.uniform(20.0, 40.0))}


def _short(random: Random) -> dict[str, Any]:
    return {"seconds": float(random.uniform(2.0, 4.0))}


def _walks(*walks: str) -> Callable[[Random], dict[str, Any]]:
    return lambda random: {"walk": tuple(str(w) for w in random.choice(walks, size=PEOPLE[1]))}


def _links(random: Random) -> dict[str, Any]:
    return {"links": str(random.choice(["star", "chain"])), "users": int(random.integers(3, PEOPLE[1] + 1))}


def _radios(least: int, most: int) -> Callable[[Random], dict[str, Any]]:
    return lambda random: {"static_radios": int(random.integers(least, most + 1))}


def _antennas(random: Random) -> dict[str, Any]:
    return {"antennas": int(random.integers(1, 3))}


def _perhaps_antennas(random: Random) -> dict[str, Any]:
    return {"antennas": int(random.random() < 0.5)}


LONGER = _set(seconds=24.0)

KINDS: dict[str, Kind] = {
    "clean": Kind(),
    "everything wrong": Kind(_set(**(WRONG | {"seconds": 30.0}))),
    "20 % NLOS": Kind(_late(0.2)),
    "30 % NLOS": Kind(_late(0.3)),
    "50 % NLOS": Kind(_late(0.5)),
    "long bursts": Kind(_bursts),
    "clocks": Kind(_set(clock_offset_sigma=0.3)),
    "heights spread by 0.4 m": Kind(_set(height_spread=0.4)),
    "heights spread by 0.8 m": Kind(_set(height_spread=0.8)),
    "drift twice": Kind(_drift),
    "lines": Kind(_walks("line")),
    "some stand still": Kind(_walks("free", "line", "still")),
    "short": Kind(_short),
    "chains and stars": Kind(_links),
    "late joiner": Kind(_set(late_joiners=1, seconds=24.0)),
    "lever arms": Kind(_antennas),
    "beacons": Kind(_radios(1, 3)),
    # The world, ...
    "odd body": Kind(fault=faults.odd_body),
    "lift or train": Kind(LONGER, faults.carried),
    # ... SLAM's frames, ...
    "slip": Kind(LONGER, faults.slip),
    "relocalisation": Kind(LONGER, faults.relocalisation),
    "two maps": Kind(LONGER, faults.two_maps),
    "other unit": Kind(fault=faults.other_unit),
    "georeferenced": Kind(fault=faults.georeferenced),
    # ... ranges, ...
    "other NLOS": Kind(_late(0.3), faults.other_detours),
    "blocked pair": Kind(fault=faults.blocked_pair),
    "pocket": Kind(LONGER, faults.pocket),
    "short ranges": Kind(_set(seconds=20.0), faults.short_ranges),
    "odd radio": Kind(fault=faults.odd_radio),
    "swapped radios": Kind(_set(users=4), faults.swapped_radios),
    # ... settings, ...
    "surveyed": Kind(_radios(2, 5), faults.surveyed),
    "wrongly surveyed": Kind(_radios(3, 5), faults.wrongly_surveyed),
    "radios as one": Kind(_radios(3, 4), faults.one_radio_of_all),
    # ... and how poses come, stamps last.
    "sparse": Kind(fault=faults.sparse),
    "frozen": Kind(LONGER, faults.frozen),
    "wxyz": Kind(_perhaps_antennas, faults.wxyz),
    "identity": Kind(_perhaps_antennas, faults.identity),
    "from velocity": Kind(_perhaps_antennas, faults.from_velocity),
    "clock step": Kind(LONGER, faults.clock_step),
    "stray stamp": Kind(fault=faults.stray_stamp),
}
"""In the order in which they are done where several are the matter."""
ALTERNATIVES = (
    {"20 % NLOS", "30 % NLOS", "50 % NLOS", "long bursts", "other NLOS"},
    {"heights spread by 0.4 m", "heights spread by 0.8 m"},
    {"drift twice", "everything wrong"},
    {"lines", "some stand still"},
    {"beacons", "surveyed", "wrongly surveyed", "radios as one"},
    {"wxyz", "identity", "from velocity"},
)
"""Of which at most one is the matter."""
MIXED = [name for name in KINDS if name not in ("clean", "short")]
FAMILIES = (*KINDS, ABREAST, MIXTURE)
_ROUND = (*KINDS, ABREAST, *[MIXTURE] * 9)
"""Of so many scenes, one after the other, which is which: two in ten are mixtures."""


class Drawn(NamedTuple):
    """One scene."""

    family: str
    seed: int
    kinds: tuple[str, ...]
    """What is the matter."""
    trial: Trial


def tasks(which: str, count: int, first: int = 0) -> list[tuple[str, int]]:
    """So many families and seeds; each seed is of one scene alone."""
    return [(_ROUND[n % len(_ROUND)], BASES[which] + n) for n in range(first, first + count)]


def _mixed(random: Random) -> tuple[str, ...]:
    """Two or three kinds that go together, in their order."""
    count, chosen = int(random.integers(2, 4)), set[str]()
    for name in random.permutation(MIXED).tolist():
        if len(chosen) < count and not any(name in group and group & chosen for group in ALTERNATIVES):
            chosen.add(name)
    return tuple(name for name in KINDS if name in chosen)


def drawn(family: str, seed: int) -> Drawn:
    """A scene; the same again for the same family and seed."""
    random = np.random.default_rng([seed, *family.encode()])
    kinds: tuple[str, ...] = (family,)
    if family == MIXTURE:
        kinds = _mixed(random)
    users, seconds = int(random.integers(PEOPLE[0], PEOPLE[1] + 1)), float(random.choice(SECONDS))
    if family == ABREAST:
        scene = Scene(users=2, seconds=seconds, seed=seed)
        return Drawn(family, seed, kinds, Trial.of(side_by_side(scene, float(random.uniform(0.05, 1.0)))))
    settings: dict[str, Any] = {"users": users, "seconds": seconds}
    for kind in kinds:
        settings |= KINDS[kind].scene(random)
    trial = Trial.of(simulate(Scene(seed=seed, **settings)))
    for kind in kinds:
        fault = KINDS[kind].fault
        if fault is not None:
            trial = fault(trial, random)
    return Drawn(family, seed, kinds, trial)
