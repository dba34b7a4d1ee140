"""Walks whose ranges are measured by the modules' own firmware, running in a simulated air.

People and their SLAM are those of `simulate`. Each device carries a module; the modules find one another, range by a
scheme, and send what they measured by UDP to the same collector that hears real ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.errors import InputError
from synchronizar.simulation.air import Frame
from synchronizar.simulation.collect import collect
from synchronizar.simulation.radios import Device, Measured, antenna_positions, bursts, linked_pairs
from synchronizar.simulation.scenario import MOST_MODULES, Blocked, Module, Scenario
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, people_of

CRYSTAL_PPM = 20.0
"""By how much crystals are off, at most: IEEE 802.15.4 allows a UWB radio no more."""
SWITCHED_ON_S = 0.05
"""Within which those who are there from the start switch on."""
BLOCKED_STEP_S = 0.02
"""At its multiples bursts of late signals begin and end."""
RANGE_OF_STAMP = np.sqrt(6.0) / 4.0
"""1 sigma of a range over that of a stamp, where both replies take equally long: double-sided ranging then errs by
(n2 + 2 n4 + n6) / 4, with n2, n4 and n6 the noise of the stamps at which poll, answer and final come in. Where the
first reply takes the share u of both it errs by ((1 - u) n2 + n4 + u n6) / 2, so that the ratio is 0.61 to 0.71."""
MOST_M = {
    "sigma": 5.0,
    "late_mean": 100.0,
    "bias_sigma": 1.0,
    "area": 1000.0,
    "height": 1000.0,
    "height_spread": 100.0,
    "height_bob": 1000.0,
}
"""m: so that neither noise nor chance leads beyond what the simulated air takes (firmware/targets/host/SCENARIO.md)."""
FRAMES_OF_A_RANGE = 3


class Air(NamedTuple):
    """Through what modules range, and how."""

    seconds: float
    scheme: str
    """Who sends when: one of SCHEMES."""
    sigma: float
    """m, 1 sigma: noise of a range."""
    loss: float = 0.0
    """0 to 1: share of ranges that fail."""
    blocked: Blocked | None = None


class Heard(NamedTuple):
    """A walk with modules, and how what they measured came through."""

    simulation: Simulation
    datagrams: int
    dropped: int
    """Ranges that modules gave up because they could not be sent in time."""
    frames: list[Frame]
    """All that was on air, if asked for."""


def simulate_modules(scene: Scene, scheme: str, frames: bool = False) -> Heard:
    """The walk that a scene describes, ranged by modules; the same for the same scene and scheme.

    Raises InputError for what modules cannot do, naming the option, and where the simulated air is not there or fails.
    """
    _refuse(scene)
    people, random = people_of(scene)
    blockage = blockage_of(random, scene)
    air = Air(scene.seconds, scheme, scene.sigma, scene.loss, blockage.spans())
    scenario = scenario_of(random, people.devices, air)
    collected = collect(scenario, people.users, frames)
    ranges = collected.ranges.select(blockage.column(collected.ranges.a, collected.ranges.b) >= 0)
    extra = blockage.at(ranges.t - collected.behind, ranges.a, ranges.b)
    simulation = people.behind(collected.behind).measured(scene, Measured(ranges, extra > 0.0, extra))
    return Heard(simulation, collected.datagrams, collected.dropped, collected.frames)


def _refuse(scene: Scene) -> None:
    for name, most in MOST_M.items():
        if abs(value := getattr(scene, name)) > most:
            raise InputError(f"--{name.replace('_', '-')}", f"is at most {most:g} m with --modules, not {value:g}")
    if scene.links != "all":
        raise InputError("--links", f"modules range with everybody: '{scene.links}' does not go with --modules")
    if scene.antennas > 1:
        raise InputError("--antennas", f"a module has one: {scene.antennas} do not go with --modules")
    if scene.rate_hz is not None:
        raise InputError("--rate-hz", "does not go with --modules, which range as often as their scheme has it")
    if scene.users + scene.static_radios > MOST_MODULES:
        raise InputError("--users", f"--modules are at most {MOST_MODULES} in one network, static radios among them")


def scenario_of(random: np.random.Generator, devices: Sequence[Device], air: Air) -> Scenario:
    """Modules on devices, each with its first antenna; a device's own stamp less its clock offset is simulated time.

    Tracks that begin before time 0 do so by one pose at most; a module is on while its device's track lasts. What the
    air does not take is told when the scenario is run.
    """
    return Scenario(
        seconds=air.seconds,
        scheme=air.scheme,
        seed=int(random.integers(2**32)),
        session=int(random.integers(2**32)),
        key=random.bytes(32),
        stamp_sigma=air.sigma / RANGE_OF_STAMP,
        frame_loss=1.0 - (1.0 - air.loss) ** (1.0 / FRAMES_OF_A_RANGE),
        modules=[_module(random, device, air.seconds) for device in devices],
        blocked=air.blocked,
    )


def _module(random: np.random.Generator, device: Device, seconds: float) -> Module:
    """Of a device: crystals as they come, switched on some moment after the device appears; off as it goes."""
    radio_ppm, board_ppm = random.uniform(-CRYSTAL_PPM, CRYSTAL_PPM, 2).tolist()
    # Tracks begin up to one pose before everything does.
    t = np.maximum(device.track.t - device.clock_offset, 0.0)
    first = np.zeros(len(t), dtype=np.int32)
    position, _ = antenna_positions([device], t, first, first)
    on = float(t[0]) + SWITCHED_ON_S * random.uniform()
    off = np.inf if device.static or t[-1] >= seconds else float(t[-1])
    return Module(radio_ppm, board_ppm, on, t, position, off, device.bias)


class Blockage(NamedTuple):
    """Which pairs have no line of sight when."""

    a: Indices
    """(pairs,) one device of each pair that ranges."""
    b: Indices
    extra: Array
    """(steps, pairs) m, each for BLOCKED_STEP_S: by how much signals come later, the same all through a burst; 0 where
    there is a line of sight."""

    def column(self, a: Indices, b: Indices) -> Indices:
        """(n,) which pair devices a and b are; -1 where they are none."""
        k = 1 + int(max(self.a.max(), self.b.max()))
        column = np.full((k, k), -1, dtype=np.int32)
        column[self.a, self.b] = column[self.b, self.a] = np.arange(len(self.a))
        return np.asarray(column[a, b])

    def at(self, t: Array, a: Indices, b: Indices) -> Array:
        """(n,) m: by how much signals between devices a and b come later at t (n,) s."""
        step = np.clip((t / BLOCKED_STEP_S).astype(np.intp), 0, len(self.extra) - 1)
        return np.asarray(self.extra[step, self.column(a, b)])

    def spans(self) -> Blocked:
        """The same as the air is told."""
        edges = BLOCKED_STEP_S * np.arange(len(self.extra) + 1, dtype=float)
        change = np.diff((self.extra > 0.0).astype(np.int8), axis=0, prepend=0, append=0).T
        pair, begin = np.nonzero(change > 0)
        _, end = np.nonzero(change < 0)
        return Blocked(self.a[pair], self.b[pair], edges[begin], edges[end], self.extra[begin, pair])


def blockage_of(random: np.random.Generator, scene: Scene) -> Blockage:
    """When signals between a scene's devices are late."""
    a, b = linked_pairs(scene)
    begin = BLOCKED_STEP_S * np.arange(np.ceil(scene.seconds / BLOCKED_STEP_S))
    _, extra = bursts(random, scene, np.broadcast_to(begin[:, None], (len(begin), len(a))))
    return Blockage(a, b, extra)
