"""Reads bags of ROS 1 and ROS 2 (sqlite3 and MCAP, compressed or not) without ROS. Needs the extra `ros`.

| | |
|---|---|
| poses | nav_msgs/Odometry, geometry_msgs/PoseStamped, PoseWithCovarianceStamped, whatever else has a pose; Path |
| TF | a body in its odometry's frame, for devices without a topic of poses |
| ranges | sensor_msgs/Range; any message with a number called range, distance, dis, ...: one, or a list of them |
| names | devices by topics or frames; radios by ids in messages or by topics, matched to devices by number |
| truth | topics of motion capture (vrpn, vicon, mocap, ground_truth, ...); track as well where there is no odometry |
| time | s since 1970: messages' own stamps; when they were logged where they have none or of another clock |
| units | m and unit quaternions x y z w, as ROS has them; ranges of real numbers m, of integers mm, unless told |
| frames | z up, bodies x forward (REP 103); `--world` and `--body` for others |
| refused | bags whose types are not known and have no definitions with them; bags that are broken |

`--list` tells what is guessed of each topic; `--topic` and `--map` say otherwise.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from synchronizar.convert.asked import Asked
from synchronizar.convert.fields import Topic
from synchronizar.convert.imported import Imported
from synchronizar.convert.mapping import mapped
from synchronizar.convert.messages import broken, imported_of
from synchronizar.convert.messages import listing as listing_of
from synchronizar.convert.ros_types import fields_of, short_type, store_of
from synchronizar.convert.source import Source
from synchronizar.convert.takers import Decode
from synchronizar.errors import os_faults
from synchronizar.progress import Progress

ROS1 = b"#ROSBAG V2.0"
SQLITE = b"SQLite format 3\0"
REMEDY = "`ros2 bag reindex` or `rosbag reindex` mends some"


def recognises(source: Source) -> bool:
    """A folder with metadata.yaml of a bag, a .bag, or a .db3."""
    if source.is_folder:
        return "metadata.yaml" in source.names and any(n.endswith((".db3", ".mcap", ".zstd")) for n in source.names)
    return source.head.startswith(ROS1) or (source.suffix == ".db3" and source.head.startswith(SQLITE))


def listing(path: Path, asked: Asked) -> list[str]:
    """A line for each topic."""
    with _opened(path, asked) as bag:
        return listing_of(bag, asked, str(path))


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """Tracks, truth and ranges. Raises InputError where the bag cannot be read."""
    with _opened(path, asked) as bag:
        return imported_of(bag, asked, str(path), progress)


class _Bag:
    """A bag of either kind, open."""

    def __init__(self, reader: Any, ros: int, asked: Asked) -> None:
        from rosbags.interfaces import MessageDefinitionFormat

        definitions = [
            (c.msgtype, "msg" if c.msgdef.format == MessageDefinitionFormat.MSG else "idl", c.msgdef.data)
            for c in reader.connections
            if c.msgdef.format != MessageDefinitionFormat.NONE
        ]
        self.remedy, self._reader = REMEDY, reader
        store = store_of(definitions, ros, mapped(asked).types)
        self._decode = store.deserialize_ros1 if ros == 1 else store.deserialize_cdr
        self._begin, self._span = reader.start_time, max(reader.duration, 1)
        kinds = {c.topic: c.msgtype for c in reader.connections}
        counts = {c.topic: 0 for c in reader.connections}
        for connection in reader.connections:
            counts[connection.topic] += connection.msgcount
        self.topics = [
            Topic(name, short_type(of), counts[name], fields_of(store, of)) for name, of in sorted(kinds.items())
        ]

    def read(self, names: Collection[str]) -> Iterator[tuple[str, float, Decode, float]]:
        """As `Messages.read`."""
        connections = [c for c in self._reader.connections if c.topic in names]
        for connection, logged, data in self._reader.messages(connections=connections):
            decode = partial(self._decode, data, connection.msgtype)
            yield connection.topic, 1e-9 * logged, decode, (logged - self._begin) / self._span


@contextmanager
def _opened(path: Path, asked: Asked) -> Iterator[_Bag]:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    ros = 2
    if not path.is_dir():
        with os_faults(path), path.open("rb") as file:
            ros = 1 if file.read(len(ROS1)) == ROS1 else 2
    with broken(path, REMEDY):
        reader = Reader1(path) if ros == 1 else Reader2(path)
        reader.open()
    try:
        with broken(path, REMEDY):
            bag = _Bag(reader, ros, asked)
        yield bag
    finally:
        reader.close()
