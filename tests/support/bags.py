"""Small bags, made by hand: what is written into them stands in the tests."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

POSES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")


def store_with(definitions: dict[str, str], ros: int) -> Any:
    """A typestore of ROS 1 or 2 and message types of one's own, by name and text."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    for name, text in definitions.items():
        store.register(get_types_from_msg(text, name))
    return store


def write_bag(path: Path, kind: str, store: Any, messages: Iterable[tuple[str, str, float, Any]]) -> Path:
    """A bag of kind ros1, sqlite3 or mcap with messages (topic, type, when logged (s), message)."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    one = kind == "ros1"
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Writer1(path) if one else Writer2(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for topic, name, logged, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            data = store.serialize_ros1(message, name) if one else store.serialize_cdr(message, name)
            writer.write(connections[topic], round(1e9 * logged), data)
    return path


def header(store: Any, t: float, frame: str = "") -> Any:
    """A header; that of ROS 1 has a number too."""
    sec, nsec = divmod(round(1e9 * t), 10**9)
    stamp = store.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nsec)
    return store.types["std_msgs/msg/Header"](
        **_known(store, "std_msgs/msg/Header", seq=0, stamp=stamp, frame_id=frame)
    )


def pose(store: Any, row: Sequence[float]) -> Any:
    """A geometry_msgs/Pose of x y z qx qy qz qw."""
    types = store.types
    return types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](**dict(zip("xyz", row[:3], strict=True))),
        orientation=types["geometry_msgs/msg/Quaternion"](**dict(zip("xyzw", row[3:], strict=True))),
    )


def pose_message(store: Any, name: str, t: float, row: Sequence[float], frame: str = "", child: str = "") -> Any:
    """A message of one of POSES."""
    types, at = store.types, pose(store, row)
    head = header(store, t, frame)
    if name == "geometry_msgs/msg/PoseStamped":
        return types[name](header=head, pose=at)
    covered = types["geometry_msgs/msg/PoseWithCovariance"](pose=at, covariance=np.zeros(36))
    if name == "geometry_msgs/msg/PoseWithCovarianceStamped":
        return types[name](header=head, pose=covered)
    zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    twist = types["geometry_msgs/msg/Twist"](linear=zero, angular=zero)
    moving = types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36))
    return types[name](header=head, child_frame_id=child, pose=covered, twist=moving)


def path_message(store: Any, t: float, rows: Iterable[Sequence[float]], stamped: bool = True) -> Any:
    """A nav_msgs/Path of t x y z qx qy qz qw."""
    name = "geometry_msgs/msg/PoseStamped"
    poses = [pose_message(store, name, row[0] if stamped else 0.0, row[1:]) for row in rows]
    return store.types["nav_msgs/msg/Path"](header=header(store, t, "map"), poses=poses)


def range_message(store: Any, t: float, distance: float, frame: str = "") -> Any:
    """A sensor_msgs/Range."""
    return store.types["sensor_msgs/msg/Range"](
        header=header(store, t, frame),
        radiation_type=0,
        field_of_view=0.0,
        min_range=0.0,
        max_range=100.0,
        range=distance,
        **_known(store, "sensor_msgs/msg/Range", variance=0.0),
    )


def transforms(store: Any, t: float, edges: Iterable[tuple[str, str, Sequence[float]]]) -> Any:
    """A tf2_msgs/TFMessage of edges (parent, child, x y z qx qy qz qw)."""
    types = store.types
    many = []
    for parent, child, row in edges:
        many.append(
            types["geometry_msgs/msg/TransformStamped"](
                header=header(store, t, parent),
                child_frame_id=child,
                transform=types["geometry_msgs/msg/Transform"](
                    translation=types["geometry_msgs/msg/Vector3"](**dict(zip("xyz", row[:3], strict=True))),
                    rotation=types["geometry_msgs/msg/Quaternion"](**dict(zip("xyzw", row[3:], strict=True))),
                ),
            )
        )
    return types["tf2_msgs/msg/TFMessage"](transforms=many)


def walk(n: int = 20, rate: float = 10.0, begin: float = 1000.0, phase: float = 0.0) -> np.ndarray[Any, Any]:
    """(n, 8) t x y z qx qy qz qw: a walk on a curve."""
    t = begin + np.arange(n) / rate
    s = np.arange(n) / rate + phase
    half = 0.1 * s
    zero = np.zeros(n)
    return np.column_stack([t, s, np.sin(s), zero + 1.2, zero, zero, np.sin(half), np.cos(half)])


def _known(store: Any, name: str, **values: Any) -> dict[str, Any]:
    """Of these fields those that the type has."""
    fields = {field for field, _ in store.fielddefs[name][1]}
    return {key: value for key, value in values.items() if key in fields}


__all__ = ["header", "path_message", "pose_message", "range_message", "store_with", "transforms", "walk", "write_bag"]
