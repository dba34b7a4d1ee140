"""Simulated walkers: true tracks of hand-held devices in a room."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.track import Track
from synchronizar.simulation.scene import Scene

TURN_S = 1.0
"""s that a walker takes to turn a corner."""
STEP_HZ = 1.8
SPEED_VARIATION = 0.3
SWAY_M = 0.015
"""m: peak sway of a standing person on each axis, about 1 cm on average."""
TILT_RAD = 0.15
"""rad: 1 sigma of a device's mean pitch and roll."""
WOBBLE_RAD = 0.1
LOOK_AROUND_RAD = 0.4


def walk(rng: np.random.Generator, scene: Scene, kind: str, t: Array) -> Track:
    """True poses of one device in the room's frame at evenly spaced times t (n,) s, for a walk of the given kind.

    The room's frame has its origin on the floor in the middle, z up. Body axes: x where the walker faces, y left, z up.
    """
    height = scene.height + scene.height_spread * rng.standard_normal()
    if kind == "still":
        place = np.array([*rng.uniform(-0.5, 0.5, 2) * scene.area, height])
        position = place + SWAY_M * np.column_stack([_wander(rng, t) for _ in range(3)])
        heading = np.full(len(t), rng.uniform(-np.pi, np.pi))
    else:
        xy, heading = _stroll(rng, scene, kind, t)
        step = np.sin(2.0 * np.pi * (STEP_HZ * t + rng.uniform()))
        bob = scene.height_bob * (step + rng.uniform(1.0, 2.0) * _wander(rng, t))
        position = np.column_stack([xy, height + bob])
    yaw = heading + LOOK_AROUND_RAD * _wander(rng, t)
    pitch = TILT_RAD * rng.standard_normal() + WOBBLE_RAD * _wander(rng, t)
    roll = TILT_RAD * rng.standard_normal() + WOBBLE_RAD * _wander(rng, t)
    return Track(t, position, _attitude(yaw, pitch, roll))


def _stroll(rng: np.random.Generator, scene: Scene, kind: str, t: Array) -> tuple[Array, Array]:
    """Positions (n, 2) m and headings (n,) rad of a walk from corner to corner, smoothed by a moving mean."""
    margin = round(0.5 * TURN_S * scene.track_rate_hz)
    window = np.hanning(2 * margin + 3)[1:-1]
    window /= window.sum()

    n = len(t) + 2 * margin
    step_s = 1.0 / scene.track_rate_hz
    speed = scene.speed * (1.0 + SPEED_VARIATION * _wander(rng, step_s * np.arange(n, dtype=float)))
    way = np.cumsum(speed) * step_s
    corners = _line(rng, scene.area, way[-1]) if kind == "line" else _waypoints(rng, scene.area, way[-1])

    legs = np.diff(corners, axis=0)
    reached = np.concatenate([[0.0], np.cumsum(np.linalg.norm(legs, axis=1))])
    leg_heading = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
    leg = np.searchsorted(reached, way, side="right") - 1
    columns = (np.interp(way, reached, corners[:, 0]), np.interp(way, reached, corners[:, 1]), leg_heading[leg])
    x, y, heading = (np.convolve(c, window, mode="valid") for c in columns)
    return np.column_stack([x, y]), heading


def _waypoints(rng: np.random.Generator, area: float, way: float) -> Array:
    """(n, 2) m: random corners in the room for a walk of length `way` (m).

    Two random points of a square are 0.52 sides apart on average, so that these are more than twice as many as needed.
    """
    return area * rng.uniform(-0.5, 0.5, (8 + int(np.ceil(4.0 * way / area)), 2))


def _line(rng: np.random.Generator, area: float, way: float) -> Array:
    """(n, 2) m: corners of a walk to and fro on a random line of half a side's length, from a random start on it."""
    angle = rng.uniform(-np.pi, np.pi)
    half = 0.25 * area * np.array([np.cos(angle), np.sin(angle)])
    middle = 0.25 * area * rng.uniform(-1.0, 1.0, 2)
    side = np.where(np.arange(3 + int(np.ceil(2.0 * way / area))) % 2, 1.0, -1.0)
    side[0] = rng.uniform(-1.0, 0.9)
    return middle + side[:, None] * half


def _wander(rng: np.random.Generator, t: Array) -> Array:
    """(n,) a slow random signal within -1 and 1: the mean of three sines with periods of 3 to 12 s."""
    periods = rng.uniform(3.0, 12.0, 3)
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    course: Array = np.sin(2.0 * np.pi * t[:, None] / periods + phases).mean(axis=1)
    return course


def _attitude(yaw: Array, pitch: Array, roll: Array) -> Array:
    """(n, 4) x y z w: attitudes Rz(yaw) Ry(pitch) Rx(roll), body axes into the room's axes."""
    sy, sp, sr = np.sin(0.5 * yaw), np.sin(0.5 * pitch), np.sin(0.5 * roll)
    cy, cp, cr = np.cos(0.5 * yaw), np.cos(0.5 * pitch), np.cos(0.5 * roll)
    return np.column_stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )
