"""Simulated radios: which pair ranges when, and the error of each range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.ranges import Ranges
from synchronizar.data.track import Track
from synchronizar.quaternions import rotate_by_quaternions
from synchronizar.simulation.scene import SHORTEST_DETOUR_M, Scene

STAMP_JITTER = 0.1
"""Largest jitter of a stamp, as a share of the time that a pair has in a round."""
DETOUR_FLUCTUATION = 0.2
"""1 sigma, relative, of the extra length from one NLOS range to the next within a burst."""
POWER_AT_1_M_DBM = -63.0
SHADOWING_DB = 1.0
FIRST_PATH_LOSS_DB = {False: (3.0, 1.5), True: (12.0, 3.0)}
"""Total received power minus that of the first path, mean and 1 sigma, by whether the range is NLOS."""


@dataclass(frozen=True)
class Device:
    """The truth of a device that carries a radio."""

    track: Track
    """True poses in the room's frame, by the device's own clock; a static radio's one pose holds at all times."""
    static: bool
    levers: Array
    """(m, 3) m: lever arms of its antennas in the body frame; m = 0: one antenna at the origin."""
    clock_offset: float
    """s: own stamp minus range stamp of the same event."""
    bias: float
    """m: range bias of its radio."""


@dataclass(frozen=True)
class Measured:
    """n ranges in the order of time, and which are NLOS."""

    ranges: Ranges
    late: Mask
    """(n,) whether the range is NLOS."""
    extra: Array
    """(n,) m: its extra length; 0 in line of sight."""


def measure(rng: np.random.Generator, scene: Scene, devices: Sequence[Device]) -> Measured:
    """All ranges of a scene; `devices` are its users, then its static radios.

    A pair does not range while the track of either does not cover the time.
    """
    t, a, b = _schedule(rng, scene)
    late, detour = bursts(rng, scene, t)
    # Log-normal with mean 1, so that the extra length stays positive.
    flutter = np.exp(DETOUR_FLUCTUATION * rng.standard_normal(t.shape) - 0.5 * DETOUR_FLUCTUATION**2)
    extra = detour * flutter
    a, b = np.broadcast_to(a, t.shape).ravel(), np.broadcast_to(b, t.shape).ravel()
    t, late, extra = t.ravel(), late.ravel(), extra.ravel()

    antennas = np.array([len(d.levers) for d in devices])
    antenna_a, antenna_b = (_pick_antenna(rng, antennas[end]) for end in (a, b))
    true, both_there = true_distances(devices, t, (a, antenna_a), (b, antenna_b))
    bias = np.array([d.bias for d in devices])
    noise = scene.sigma * rng.standard_normal(len(t))
    optional: dict[str, Array | Indices] = {"antenna_a": antenna_a, "antenna_b": antenna_b}
    if scene.power:
        optional["rx_power"], optional["fp_power"] = _power(rng, true, late)
    ranges = Ranges.of(t, a, b, true + bias[a] + bias[b] + extra + noise, **optional)

    there = both_there & (t < scene.seconds) & (rng.uniform(size=len(t)) >= scene.loss)
    order = np.argsort(t, kind="stable")
    kept = order[there[order]]
    return Measured(ranges.select(kept), late[kept], extra[kept])


def linked_pairs(scene: Scene) -> tuple[Indices, Indices]:
    """Pairs that range: the index of the first and of the second device, (pairs,) each."""
    a, b = np.triu_indices(scene.users + scene.static_radios, 1)
    linked = a < scene.users
    if scene.links == "star":
        linked &= a == 0
    elif scene.links == "chain":
        linked &= (b == a + 1) | (a == scene.users - 1)
    return a[linked].astype(np.int32), b[linked].astype(np.int32)


def _schedule(rng: np.random.Generator, scene: Scene) -> tuple[Array, Indices, Indices]:
    """Stamps (rounds, pairs) s of rounds in which each pair ranges once, and the pairs' two devices (pairs,) each."""
    a, b = linked_pairs(scene)
    rounds, pairs = int(np.ceil(scene.seconds * scene.round_hz)), len(a)
    turn = np.arange(pairs) + 0.5 + STAMP_JITTER * rng.uniform(-1.0, 1.0, (rounds, pairs))
    return (np.arange(rounds)[:, None] + turn / pairs) / scene.round_hz, a, b


def bursts(rng: np.random.Generator, scene: Scene, t: Array) -> tuple[Mask, Array]:
    """Which signals at t (rounds, pairs) s are NLOS, and the mean extra length (rounds, pairs) m of their burst.

    Each pair is a Markov process of two states. For the NLOS share q and bursts of B s on average: at the times of a
    Poisson process with rate 1 / (B (1 - q)) the state is drawn again, NLOS with probability q, whatever it was.
    """
    q = scene.late_share
    row = np.arange(len(t))[:, None]
    renewed = np.ones(t.shape, dtype=bool)
    if q < 1.0:
        waited = np.diff(t, axis=0) / (scene.late_burst_s * (1.0 - q))
        renewed[1:] = rng.uniform(size=waited.shape) < -np.expm1(-waited)
    drawn = rng.uniform(size=t.shape) < q
    late = np.take_along_axis(drawn, np.maximum.accumulate(np.where(renewed, row, 0)), axis=0)

    begins = late.copy()
    begins[1:] &= ~late[:-1]
    level = SHORTEST_DETOUR_M + rng.exponential(scene.late_mean - SHORTEST_DETOUR_M, t.shape)
    of_burst = np.take_along_axis(level, np.maximum.accumulate(np.where(begins, row, 0)), axis=0)
    return late, np.where(late, of_burst, 0.0)


def _pick_antenna(rng: np.random.Generator, count: Indices) -> Indices:
    """(n,) random antenna of each device with `count` (n,) antennas; -1, the origin, where it has none."""
    return np.where(count > 0, rng.integers(0, np.maximum(count, 1)), -1).astype(np.int32)


def true_distances(
    devices: Sequence[Device], t: Array, end_a: tuple[Indices, Indices], end_b: tuple[Indices, Indices]
) -> tuple[Array, Mask]:
    """True distances (n,) m at range stamps t (n,) s, and whether both devices' tracks cover them (n,).

    An end is its device's index and its antenna's, (n,) each.
    """
    p_a, a_there = antenna_positions(devices, t, *end_a)
    p_b, b_there = antenna_positions(devices, t, *end_b)
    return np.linalg.norm(p_a - p_b, axis=1), a_there & b_there


def antenna_positions(devices: Sequence[Device], t: Array, who: Indices, antenna: Indices) -> tuple[Array, Mask]:
    """True antenna positions (n, 3) m at range stamps t (n,) s, and whether the device's track covers them (n,)."""
    position, there = np.empty((len(t), 3)), np.ones(len(t), dtype=bool)
    for i, device in enumerate(devices):
        mine = np.flatnonzero(who == i)
        if device.static:
            position[mine] = device.track.position
            continue
        poses = device.track.at(t[mine] + device.clock_offset, max_gap=np.inf)
        position[mine], there[mine] = poses.position, poses.valid
        if len(device.levers):
            position[mine] += rotate_by_quaternions(poses.quat_xyzw, device.levers[antenna[mine]])
    return position, there


def _power(rng: np.random.Generator, distance: Array, late: Mask) -> tuple[Array, Array]:
    """Total received power and that of the first path, (n,) dBm each."""
    n = len(distance)
    total = POWER_AT_1_M_DBM - 20.0 * np.log10(np.maximum(distance, 0.1)) + SHADOWING_DB * rng.standard_normal(n)
    mean, sigma = (np.where(late, FIRST_PATH_LOSS_DB[True][i], FIRST_PATH_LOSS_DB[False][i]) for i in (0, 1))
    return total, total - (mean + sigma * rng.standard_normal(n))
