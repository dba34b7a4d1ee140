"""Robots' poses out of the transforms that come, where nothing else tells them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from synchronizar.convert.reading import Pose
from synchronizar.convert.transforms import FrameTrack, StampedTransform, Transforms, transform_of
from synchronizar.quaternions import multiply_quaternions, rotate_by_quaternions

LOOKED_EVERY_S = 2.0
"""s of transforms in which robots are looked for."""


class TfPose(NamedTuple):
    """A body in the frame of its own odometry."""

    child: str
    user: str
    stamp: float
    parent: str
    pose: Pose


class TfPoses:
    """Of one rosbridge."""

    def __init__(self, common: str) -> None:
        """`common`: a frame that is left out, as are frames in it: it is what comes out of the room."""
        self._common = common
        self._static: dict[tuple[str, str], StampedTransform] = {}
        self._newest: dict[tuple[str, str], StampedTransform] = {}
        self._window, self._began = Transforms(), np.inf
        self._tracks: dict[str, FrameTrack] = {}

    def take(self, topic: str, arrived: float, message: Any) -> Iterator[TfPose]:
        """Poses of those whose frames have moved. Raises ValueError, after them, for a transform that is none."""
        space, is_static = topic.strip("/").rpartition("/")[0], topic.rstrip("/").endswith("tf_static")
        several = message["transforms"] if isinstance(message, Mapping) and "transforms" in message else [message]
        moved, faults = set(), 0
        for one in several:
            transform = transform_of(space, arrived, one)
            if transform.parent.rpartition("/")[2] == self._common:
                continue
            if not np.isfinite(transform.pose).all():
                faults += 1
                continue
            edge = transform.child, transform.parent
            self._newest[edge] = transform
            if is_static:
                self._static[edge] = transform
            moved.add(edge)
            self._window.put(transform, is_static)
        self._look(arrived)
        for track in self._tracks.values():
            if track.chain[track.leading : track.leading + 2] in moved:
                yield TfPose(track.child, track.user or "robot", *self._composed(track))
        if faults:
            raise ValueError(f"{faults} transforms are none")

    def _look(self, arrived: float) -> None:
        """Now and then, who is there: a robot that was found stays."""
        self._began = min(self._began, arrived)
        if arrived - self._began < LOOKED_EVERY_S:
            return
        for track in self._window.tracks():
            self._tracks.setdefault(track.user, track)
        self._window, self._began = Transforms(), arrived
        for transform in self._static.values():
            self._window.put(transform, True)

    def _composed(self, track: FrameTrack) -> tuple[float, str, Pose]:
        """By the newest of each transform of its chain; the stamp is that of what moves most often."""
        position, quat, stamp = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 0.0
        for k in range(len(track.chain) - 1):
            of = self._newest[track.chain[k], track.chain[k + 1]]
            turn = np.array(of.pose[3:])
            position = np.array(of.pose[:3]) + rotate_by_quaternions(turn[None], position[None])[0]
            quat = multiply_quaternions(turn, quat)
            stamp = of.stamp if k == track.leading else stamp
        x, y, z, qx, qy, qz, qw = np.concatenate([position, quat]).tolist()
        return stamp, track.parent, (x, y, z, qx, qy, qz, qw)
