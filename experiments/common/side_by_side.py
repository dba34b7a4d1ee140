"""Simulates two people who walk side by side, one at an offset from the other: the walk that the paper fears.

While they keep step exactly, the distance between them never changes: it tells how far away the other is and not
where, whatever else is known. The further the one strays from the other's side, the more it tells.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.geometry import YawFrame
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

ABREAST_M = 0.8
"""How far people who walk together are apart (Moussaid et al., PLoS ONE 5(4): e10047, 2010)."""
STRAY_PERIODS_S = (3.0, 12.0)
"""How slowly one strays: an assumption, that of the simulated walks' other slow courses."""


def side_by_side(scene: Scene, stray: float) -> Simulation:
    """A scene of two whose second user walks where the first does, ABREAST_M to one side and in the same step.

    `stray`: m, amplitude of how far off that place it is, on either axis in the plane. The first user, both devices'
    mean heights, the times of ranging and their noise are as in the scene; SLAM must be without drift there, and the
    second's is so too: its own frame begins at its first pose with a heading at random.
    """
    simulation = simulate(scene)
    random = np.random.default_rng([scene.seed, 1])
    first, second = (user.name for user in simulation.recording.users)
    bearing, heading = random.uniform(-np.pi, np.pi, 2).tolist()
    leader = simulation.truth[first]
    higher = float(simulation.truth[second].position[:, 2].mean() - leader.position[:, 2].mean())
    offset = np.array([ABREAST_M * np.cos(bearing), ABREAST_M * np.sin(bearing), higher])
    beside = replace(leader, position=leader.position + offset + _straying(random, leader.t, stray))
    x, y, z = beside.position[0].tolist()
    world_from_second = YawFrame(x, y, z, heading)
    second_from_world = world_from_second.inverse()
    own = replace(
        beside,
        position=second_from_world @ beside.position,
        quat_xyzw=second_from_world.rotate_quaternions(beside.quat_xyzw),
    )
    ranges = simulation.recording.ranges
    apart = np.linalg.norm(leader.at(ranges.t, np.inf).position - beside.at(ranges.t, np.inf).position, axis=1)
    measured = replace(ranges, distance=apart + scene.sigma * random.standard_normal(len(ranges)))
    tracks = {**simulation.recording.tracks, second: own}
    return replace(
        simulation,
        recording=Recording(simulation.recording.users, tracks, measured),
        truth={first: leader, second: beside},
        world_from_user={**simulation.world_from_user, second: world_from_second},
    )


def _straying(random: np.random.Generator, t: Array, amplitude: float) -> Array:
    """(n, 3) m: how far off one's place in the row one is, in the plane."""
    period, phase = random.uniform(*STRAY_PERIODS_S, 2), random.uniform(-np.pi, np.pi, 2)
    course = np.sin(2.0 * np.pi * t[:, None] / period + phase)
    return amplitude * np.column_stack([course, np.zeros(len(t))])
