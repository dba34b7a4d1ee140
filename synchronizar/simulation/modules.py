"""Simulated walks with ranges measured by the modules' own firmware in the simulated air.

Walkers and their SLAM are those of `simulate`. Each device carries a module; modules discover one another, range by a
scheme, and send their ranges by UDP to the same receiver as real ones.
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
"""Largest error of crystals: IEEE 802.15.4 allows a UWB radio no more."""
SWITCHED_ON_S = 0.05
"""s: modules that are present from the start switch on within this."""
BLOCKED_STEP_S = 0.02
"""s: bursts of NLOS begin and end at its multiples."""
RANGE_OF_STAMP = np.sqrt(6.0) / 4.0
"""1 sigma of a range over that of a stamp, for two replies of equal length: the error of double-sided ranging is then
(n2 + 2 n4 + n6) / 4, with n2, n4 and n6 the noise of the receive stamps of poll, answer and final. Where the first
reply takes the share u of both, it is ((1 - u) n2 + n4 + u n6) / 2, so that the ratio is 0.61 to 0.71."""
MOST_M = {
    "sigma": 5.0,
    "late_mean": 100.0,
    "bias_sigma": 1.0,
    "area": 1000.0,
    "height": 1000.0,
    "height_spread": 100.0,
    "height_bob": 1000.0,
}
"""m: largest settings; with them nothing exceeds the simulated air's limits (firmware/targets/host/SCENARIO.md)."""
FRAMES_OF_A_RANGE = 3


class Air(NamedTuple):
    """The channel and scheme by which modules range."""

    seconds: float
    scheme: str
    """Which module sends when: one of SCHEMES."""
    sigma: float
    """m: 1 sigma of a range's noise."""
    loss: float = 0.0
    """Share of ranges that fail, 0 to 1."""
    blocked: Blocked | None = None


class Heard(NamedTuple):
    """A simulated walk with modules, and statistics of their datagrams."""

    simulation: Simulation
    datagrams: int
    dropped: int
    """Ranges that modules dropped because they could not send them in time."""
    frames: list[Frame]
    """Frames on air, where asked for."""


def simulate_modules(scene: Scene, scheme: str, frames: bool = False) -> Heard:
    """The walk of a scene, ranged by modules; deterministic in scene and scheme.

    Raises InputError for a scene that modules cannot range, naming the option, and where the simulated air is missing
    or fails.
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
    """Raise InputError, naming the option, for a scene that modules cannot range."""
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
    """A scenario with a module on each device, at its first antenna; simulated time is own stamp minus clock offset.

    At most one pose of a track lies before time 0; a module is on while its device's track lasts. Values beyond the
    air's limits are refused when the scenario runs.
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
    """The module of a device: random crystals, on shortly after the device appears, off when its track ends."""
    radio_ppm, board_ppm = random.uniform(-CRYSTAL_PPM, CRYSTAL_PPM, 2).tolist()
    # Tracks begin up to one pose before time 0.
    t = np.maximum(device.track.t - device.clock_offset, 0.0)
    first = np.zeros(len(t), dtype=np.int32)
    position, _ = antenna_positions([device], t, first, first)
    on = float(t[0]) + SWITCHED_ON_S * random.uniform()
    off = np.inf if device.static or t[-1] >= seconds else float(t[-1])
    return Module(radio_ppm, board_ppm, on, t, position, off, device.bias)


class Blockage(NamedTuple):
    """NLOS over time: which pairs have no line of sight when."""

    a: Indices
    """(pairs,) first device of each pair that ranges."""
    b: Indices
    """(pairs,) second device."""
    extra: Array
    """(steps, pairs) m: extra length of signals in each step of BLOCKED_STEP_S, constant in a burst; 0 in line of
    sight."""

    def column(self, a: Indices, b: Indices) -> Indices:
        """(n,) index of the pair of devices a and b (n,); -1 where they do not range."""
        k = 1 + int(max(self.a.max(), self.b.max()))
        column = np.full((k, k), -1, dtype=np.int32)
        column[self.a, self.b] = column[self.b, self.a] = np.arange(len(self.a))
        return np.asarray(column[a, b])

    def at(self, t: Array, a: Indices, b: Indices) -> Array:
        """(n,) m: extra length of signals between devices a and b (n,) at t (n,) s."""
        step = np.clip((t / BLOCKED_STEP_S).astype(np.intp), 0, len(self.extra) - 1)
        return np.asarray(self.extra[step, self.column(a, b)])

    def spans(self) -> Blocked:
        """The same as spans, for the scenario."""
        edges = BLOCKED_STEP_S * np.arange(len(self.extra) + 1, dtype=float)
        change = np.diff((self.extra > 0.0).astype(np.int8), axis=0, prepend=0, append=0).T
        pair, begin = np.nonzero(change > 0)
        _, end = np.nonzero(change < 0)
        return Blocked(self.a[pair], self.b[pair], edges[begin], edges[end], self.extra[begin, pair])


def blockage_of(random: np.random.Generator, scene: Scene) -> Blockage:
    """Random NLOS bursts between a scene's devices."""
    a, b = linked_pairs(scene)
    begin = BLOCKED_STEP_S * np.arange(np.ceil(scene.seconds / BLOCKED_STEP_S))
    _, extra = bursts(random, scene, np.broadcast_to(begin[:, None], (len(begin), len(a))))
    return Blockage(a, b, extra)
