"""Simulated walks among surveyed radios, with the truth in the survey's frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from synchronizar.data.registration import Registration
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.simulation.radios import measure
from synchronizar.simulation.simulate import Scene, Simulation, people_of

CORNERS = ((3.2, -2.9, 2.4), (-3.1, -3.0, 1.9), (-2.8, 3.1, 2.8), (3.0, 2.7, 0.6))
"""m: in a room of 6 m by 6 m."""


def among(
    scene: Scene,
    places: Sequence[tuple[float, float, float]],
    said: Mapping[str, tuple[float, float, float]] | None = None,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **settings: float,
) -> Simulation:
    """A scene with a static radio at each of `places`, and all of that moved by `origin`.

    `said` are entries that say another place; `settings` are those of all radios.
    """
    said = said or {}
    scene = replace(scene, static_radios=len(places))
    people, random = people_of(scene)
    shift, radios = YawFrame(*origin), iter(places)
    users, devices, frames = [], [], {}
    for user, device in zip(people.users, people.devices, strict=True):
        track = device.track
        if user.static:
            place = next(radios)
            track = Track(np.zeros(1), np.array([place]), track.quat_xyzw)
            x, y, z = np.add(said.get(user.name, place), origin).tolist()
            user = replace(user, position=(x, y, z), **settings)
        frames[user.name] = shift @ (YawFrame(*track.position[0]) if user.static else people.world_from_user[user.name])
        users.append(user)
        devices.append(replace(device, track=replace(track, position=shift @ track.position)))
    there = replace(people, users=tuple(users), devices=tuple(devices), world_from_user=frames)
    return there.measured(scene, measure(random, scene, there.devices))


def errors(simulation: Simulation, registration: Registration) -> dict[str, tuple[float, float, float]]:
    """Of each user that is placed: m in the plane and in height of its last pose, and rad of its heading."""
    out = {}
    for name, user in registration.users.items():
        if (frame := user.common_from_user) is not None:
            own = np.zeros(3) if user.static else simulation.recording.tracks[name].position[-1]
            off = frame.z_up @ own - simulation.truth[name].position[-1]
            turn = 0.0 if user.static else wrap_angle(frame.yaw - simulation.world_from_user[name].yaw)
            out[name] = float(np.hypot(off[0], off[1])), float(abs(off[2])), abs(float(turn))
    return out
