"""Tracks out of transforms between frames (TF): a body in the frame that its own odometry or SLAM has."""

from __future__ import annotations

import re
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.fields import stamp_of
from synchronizar.data.track import interpolated
from synchronizar.io.text import MAX_PLACE
from synchronizar.quaternions import multiply_quaternions, normalized_quaternions, rotate_by_quaternions

BODIES = ("base_link", "base_footprint", "base", "body", "imu_link", "imu", "camera_link", "camera", "rig", "vehicle")
"""Frames of devices, by their last names, the likeliest first."""
_SHARED = ("world", "map", "earth", "mocap", "vicon", "optitrack", "ground_truth")
"""Roots that several devices may share."""
_LONGEST_GAP = 1e9
_LONGEST_CHAIN = 16


@dataclass
class _Edge:
    """A child in its parent, over time."""

    is_static: bool
    t: array[float] = field(default_factory=lambda: array("d"))
    poses: array[float] = field(default_factory=lambda: array("d"))

    def arrays(self) -> tuple[Array, Array]:
        """(n,) rising stamps and (n, 7) poses, without what is none."""
        t, poses = np.array(self.t), np.array(self.poses).reshape(-1, 7)
        known = np.isfinite(t) & (np.abs(poses) <= MAX_PLACE).all(axis=1)
        t, poses = t[known], poses[known]
        order = np.argsort(t, kind="stable")
        t, poses = t[order], poses[order]
        kept = np.append(t[1:] != t[:-1], True) & poses[:, 3:].any(axis=1)
        poses = poses[kept]
        return t[kept], np.column_stack([poses[:, :3], normalized_quaternions(poses[:, 3:])])


class FrameTrack(NamedTuple):
    """A body's poses in a frame above it."""

    user: str
    """Empty where no name tells."""
    child: str
    parent: str
    rows: Array
    """(n, 8) t x y z qx qy qz qw."""
    chain: tuple[str, ...]
    """Frames from the body up to the parent."""
    leading: int
    """Which frame of the chain moves most often in the one above it."""


class StampedTransform(NamedTuple):
    """A transform of a message."""

    parent: str
    child: str
    stamp: float
    """s: when it was logged, where it has no stamp of its own."""
    pose: tuple[float, ...]
    """x y z qx qy qz qw of the child in the parent."""


def transform_of(space: str, logged: float, transform: Any) -> StampedTransform:
    """One transform of a message: ROS's, as an object or JSON, or Foxglove's; `space`: its topic's namespace."""
    if isinstance(transform, Mapping) and "parent_frame_id" in transform:
        parent, child = transform["parent_frame_id"], transform["child_frame_id"]
        p, q, stamp = transform["translation"], transform["rotation"], stamp_of(transform["timestamp"])
    elif isinstance(transform, Mapping):
        parent, child = transform["header"]["frame_id"], transform["child_frame_id"]
        p, q = transform["transform"]["translation"], transform["transform"]["rotation"]
        stamp = stamp_of(transform["header"]["stamp"])
    elif hasattr(transform, "parent_frame_id"):
        parent, child = transform.parent_frame_id, transform.child_frame_id
        p, q, stamp = transform.translation, transform.rotation, stamp_of(transform.timestamp)
    else:
        parent, child = transform.header.frame_id, transform.child_frame_id
        p, q, stamp = transform.transform.translation, transform.transform.rotation, stamp_of(transform.header.stamp)
    if isinstance(p, Mapping):
        pose = (p["x"], p["y"], p["z"], q["x"], q["y"], q["z"], q["w"])
    else:
        pose = (p.x, p.y, p.z, q.x, q.y, q.z, q.w)
    parent, child = (f"{space}/{name.strip('/')}" if space else name.strip("/") for name in (parent, child))
    return StampedTransform(parent, child, stamp or logged, pose)


class Transforms:
    """All transforms of a file; frames of topics in a namespace are that namespace's own."""

    def __init__(self) -> None:
        self._edges: dict[str, dict[str, _Edge]] = {}

    def put(self, transform: StampedTransform, is_static: bool) -> None:
        """Take a transform."""
        edge = self._edges.setdefault(transform.child, {}).setdefault(transform.parent, _Edge(is_static))
        edge.t.append(transform.stamp)
        edge.poses.extend(transform.pose)

    def tracks(self) -> list[FrameTrack]:
        """Of each device one: its likeliest body in the frame above it that is its own."""
        found: dict[str, FrameTrack] = {}
        ranks: dict[str, int] = {}
        for child in sorted(self._edges):
            name = child.rpartition("/")[2]
            rank = next((k for k, body in enumerate(BODIES) if name == body or name.endswith(f"_{body}")), None)
            chain = self._chain(child)
            if rank is None and not (name and chain and all(not edge.is_static for _, edge in chain[:1])):
                continue
            rank = len(BODIES) if rank is None else rank
            if not any(not edge.is_static for _, edge in chain):
                continue
            if rank == len(BODIES) and (name in self._parents() or name in _SHARED):
                continue
            user = _user(child, name if rank == len(BODIES) else "")
            if user in found and ranks[user] <= rank:
                continue
            track = self._composed(user, child, chain)
            if track is not None:
                found[user], ranks[user] = track, rank
        return list(found.values())

    def _parents(self) -> set[str]:
        return {parent.rpartition("/")[2] for edges in self._edges.values() for parent in edges}

    def _chain(self, child: str) -> list[tuple[str, _Edge]]:
        """The frames above a body and how it gets there, up to one that others share, if there is one of its own."""
        chain: list[tuple[str, _Edge]] = []
        seen = {child}
        while child in self._edges and len(chain) < _LONGEST_CHAIN:
            parent, edge = max(self._edges[child].items(), key=lambda item: len(item[1].t))
            if parent in seen:
                break
            chain.append((parent, edge))
            seen.add(parent)
            child = parent
        moves = [k for k, (_, edge) in enumerate(chain) if not edge.is_static]
        while len(moves) > 1 and chain[-1][0].rpartition("/")[2] in _SHARED:
            chain.pop()
            moves = [k for k, (_, edge) in enumerate(chain) if not edge.is_static]
        return chain

    def _composed(self, user: str, child: str, chain: list[tuple[str, _Edge]]) -> FrameTrack | None:
        """The body's poses in the last frame of a chain, at the stamps of what moves most often in it."""
        edges = [edge.arrays() for _, edge in chain]
        moving = [k for k, (_, edge) in enumerate(chain) if not edge.is_static]
        if not moving or any(not len(t) for t, _ in edges):
            return None
        leading = max(moving, key=lambda k: len(edges[k][0]))
        stamps = edges[leading][0]
        position, quat = np.zeros((len(stamps), 3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1))
        known = np.ones(len(stamps), dtype=bool)
        for (_, edge), (t, poses) in zip(chain, edges, strict=True):
            if edge.is_static or len(t) == 1:
                p, q = np.tile(poses[-1, :3], (len(stamps), 1)), np.tile(poses[-1, 3:], (len(stamps), 1))
            else:
                at = interpolated(t, poses[:, :3], poses[:, 3:], stamps, _LONGEST_GAP)
                p, q = at.position, at.quat_xyzw
                known &= at.valid
            position = p + rotate_by_quaternions(q, position)
            quat = multiply_quaternions(q, quat)
        rows, names = np.column_stack([stamps, position, quat])[known], (child, *(parent for parent, _ in chain))
        return FrameTrack(user, child, names[-1], rows, names, leading)


def _user(child: str, name: str) -> str:
    """A body's namespace: tb1 of tb1/base_link and of tb1_base_link."""
    space = child.rpartition("/")[0]
    if space:
        return space.replace("/", "_")
    if name:
        return name
    found = re.fullmatch(rf"(.+?)[_-]({'|'.join(BODIES)})", child)
    return found[1] if found else ""
