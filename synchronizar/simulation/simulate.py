"""Simulates a scene: a recording, seeded, with its truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from synchronizar.arrays import Array, Mask
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.geometry import Up, YawFrame, wrap_angle
from synchronizar.io.tum import write_tum
from synchronizar.quaternions import multiply_quaternions
from synchronizar.simulation.radios import Device, Measured, measure, true_distances
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.walkers import walk

__all__ = ["People", "Scene", "Simulation", "people_of", "simulate"]

ANTENNA_REACH_M = 0.15
RADIO_HEIGHT_M = (2.0, 3.0)


@dataclass(frozen=True)
class Simulation:
    """A recording and its truth."""

    scene: Scene
    recording: Recording
    truth: Mapping[str, Track]
    """True tracks in the room's frame (z up), at the stamps of the own tracks; a static radio: one pose, t = 0."""
    world_from_user: Mapping[str, YawFrame]
    """Each device's own frame in the room's, at its last pose."""
    clock_offset: Mapping[str, float]
    """s: own stamp minus range stamp of the same event; 0 for a static radio, which has no clock."""
    range_bias: Mapping[str, float]
    """m: range bias of each device's radio."""
    late: Mask
    """(n,) whether each of the recording's ranges is NLOS."""
    extra: Array
    """(n,) m: extra length of the range. A module's range takes three frames; this is the extra length of signals at
    its stamp, of which the range has only a part where a burst begins or ends between the frames."""

    def range_errors(self) -> Array:
        """(n,) m: measured minus true distance of each of the recording's ranges."""
        devices = [
            Device(
                self.truth[user.name],
                user.static,
                user.levers[:-1],
                self.clock_offset[user.name],
                self.range_bias[user.name],
            )
            for user in self.recording.users
        ]
        r = self.recording.ranges
        true, _ = true_distances(devices, r.t, (r.a, r.antenna_a), (r.b, r.antenna_b))
        return r.distance - true

    def save(self, path: Path, force: bool = False) -> None:
        """Write the recording as a folder, with truth/<user>.tum and truth/ranges.csv.

        Raises InputError where it cannot be written, or holds tracks or truth of other users; `force` removes these.
        """
        truth = path / "truth"
        for file in [*(path / "tracks").glob("*.tum"), *truth.glob("*.tum")]:
            if file.stem not in self.truth or (file.parent != truth and file.stem not in self.recording.tracks):
                if not force:
                    raise InputError(
                        file, f"stands in the way: {file.stem} is not in the scene to be saved (--force removes it)"
                    )
                with os_faults(file):
                    file.unlink()
        self.recording.save(path)
        with os_faults(truth):
            truth.mkdir(exist_ok=True)
        for user in self.recording.users:
            write_tum(truth / f"{user.name}.tum", self.truth[user.name], user.up)
        self._save_range_truth(truth / "ranges.csv")

    def _save_range_truth(self, path: Path) -> None:
        names = [user.name for user in self.recording.users]
        r = self.recording.ranges
        rows = zip(r.t.tolist(), r.a.tolist(), r.b.tolist(), self.late.tolist(), self.extra.tolist(), strict=True)
        lines = [f"{t},{names[a]},{names[b]},{late:d},{extra}\n" for t, a, b, late, extra in rows]
        with os_faults(path):
            path.write_text("t,a,b,late,extra\n" + "".join(lines), encoding="utf-8")


def simulate(scene: Scene) -> Simulation:
    """The walk of a scene; deterministic in the scene."""
    people, radio = people_of(scene)
    return people.measured(scene, measure(radio, scene, people.devices))


@dataclass(frozen=True)
class People:
    """All users of a scene before ranging; static radios come last."""

    users: tuple[User, ...]
    devices: tuple[Device, ...]
    """Their truth, in the order of `users`."""
    tracks: Mapping[str, Track]
    """SLAM's own tracks."""
    world_from_user: Mapping[str, YawFrame]
    """Each own frame in the room's, at the last pose."""

    def behind(self, seconds: float) -> People:
        """The same with a range clock that is later by `seconds`."""
        devices = (d if d.static else replace(d, clock_offset=d.clock_offset - seconds) for d in self.devices)
        return replace(self, devices=tuple(devices))

    def measured(self, scene: Scene, measured: Measured) -> Simulation:
        """The simulation with these ranges."""
        by_name = {user.name: device for user, device in zip(self.users, self.devices, strict=True)}
        return Simulation(
            scene=scene,
            recording=Recording(self.users, self.tracks, measured.ranges),
            truth={name: device.track for name, device in by_name.items()},
            world_from_user=self.world_from_user,
            clock_offset={name: device.clock_offset for name, device in by_name.items()},
            range_bias={name: device.bias for name, device in by_name.items()},
            late=measured.late,
            extra=measured.extra,
        )


def people_of(scene: Scene) -> tuple[People, np.random.Generator]:
    """All users of a scene, and the random generator for their radios."""
    # Separate streams, so that walks stay the same when only SLAM or radios change.
    motion, slam, radio = np.random.default_rng(scene.seed).spawn(3)
    users, devices, tracks, world_from_user = [], [], {}, {}
    up: Up = "y" if scene.up == "y" else "z"
    for i, name in enumerate(_names("phone", scene.users)):
        kind = scene.walk[i % len(scene.walk)]
        true = walk(motion, scene, kind, _pose_times(motion, scene, joins_late=i >= scene.users - scene.late_joiners))
        levers = _levers(radio, scene.antennas)
        offset = scene.clock_offset_sigma * slam.standard_normal()
        true = replace(true, t=true.t + offset)
        tracks[name], world_from_user[name] = _slam(slam, scene, true)
        antennas = {str(n): tuple(lever) for n, lever in enumerate(levers.tolist())}
        users.append(User(name, antennas=antennas, up=up))
        devices.append(Device(true, False, levers, offset, scene.bias_sigma * radio.standard_normal()))
    for name in _names("radio", scene.static_radios):
        place = np.append(scene.area * motion.uniform(-0.5, 0.5, 2), motion.uniform(*RADIO_HEIGHT_M))
        true = Track(np.zeros(1), place[None, :], np.array([[0.0, 0.0, 0.0, 1.0]]))
        world_from_user[name] = YawFrame(*place.tolist())
        users.append(User(name, static=True, up=up))
        devices.append(Device(true, True, np.empty((0, 3)), 0.0, scene.bias_sigma * radio.standard_normal()))
    return People(tuple(users), tuple(devices), tracks, world_from_user), radio


def _names(kind: str, count: int) -> list[str]:
    """Names `kind0`, `kind1`, ..., padded so that they sort by number."""
    width = len(str(count - 1))
    return [f"{kind}{i:0{width}d}" for i in range(count)]


def _pose_times(rng: np.random.Generator, scene: Scene, joins_late: bool) -> Array:
    """(n,) s, range clock: evenly spaced from just before a device appears to just after the end."""
    start = 0.5 * scene.seconds if joins_late else 0.0
    n = int(np.ceil((scene.seconds - start) * scene.track_rate_hz)) + 2
    return start + (np.arange(n, dtype=float) - rng.uniform()) / scene.track_rate_hz


def _levers(rng: np.random.Generator, antennas: int) -> Array:
    """(antennas, 3) m, body frame: lever arms, uniform in a ball of ANTENNA_REACH_M."""
    direction = rng.standard_normal((antennas, 3))
    reach = ANTENNA_REACH_M * np.cbrt(rng.uniform(size=(antennas, 1)))
    levers: Array = reach * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return levers


def _slam(rng: np.random.Generator, scene: Scene, true: Track) -> tuple[Track, YawFrame]:
    """SLAM's own track of true poses in the room, and `world_from_user` at the last pose.

    The own frame has its origin at the first pose and a random heading. Each step is the true one, rotated by a heading
    that drifts and jumps, divided by one scale, plus drift and jumps of the position.
    """
    steps, step_s = len(true) - 1, 1.0 / scene.track_rate_hz
    scale = float(np.exp(scene.scale_sigma * rng.standard_normal()))
    shift = scene.drift_m_per_sqrt_s * np.sqrt(step_s) * rng.standard_normal((steps, 3))
    turn = scene.drift_rad_per_sqrt_s * np.sqrt(step_s) * rng.standard_normal(steps)
    at = rng.integers(steps, size=scene.jumps)
    way = rng.uniform(-np.pi, np.pi, scene.jumps)
    np.add.at(shift, at, scene.jump_m * np.column_stack([np.cos(way), np.sin(way), np.zeros(scene.jumps)]))
    np.add.at(turn, at, scene.jump_rad * rng.choice([-1.0, 1.0], scene.jumps))

    world_yaw = rng.uniform(-np.pi, np.pi) + np.concatenate([[0.0], np.cumsum(turn)])
    c, s = np.cos(world_yaw[:-1]), np.sin(world_yaw[:-1])
    dx, dy, dz = np.diff(true.position, axis=0).T / scale
    own_steps = np.column_stack([c * dx + s * dy, c * dy - s * dx, dz]) + shift
    position = np.vstack([np.zeros(3), np.cumsum(own_steps, axis=0)])
    unturn = np.zeros((len(true), 4))
    unturn[:, 2], unturn[:, 3] = -np.sin(0.5 * world_yaw), np.cos(0.5 * world_yaw)
    own = Track(true.t, position, multiply_quaternions(unturn, true.quat_xyzw))

    last = YawFrame(yaw=wrap_angle(float(world_yaw[-1])), scale=scale)
    x, y, z = (true.position[-1] - last.apply(position[-1])).tolist()
    return own, replace(last, x=x, y=y, z=z)
