"""What each topic of a file of messages is: poses, truth, transforms, ranges. What is guessed, is said."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from synchronizar.convert.fields import SECONDS, Field, Topic
from synchronizar.convert.mapping import Mapped
from synchronizar.convert.names import (
    OBSTACLE_WORDS,
    PLAN_WORDS,
    SLAM_WORDS,
    TRUTH_WORDS,
    has_word,
    pair_of_topic,
    users_of_topics,
)
from synchronizar.errors import InputError
from synchronizar.io.text import quoted

POSE_PATHS = ("pose.pose", "pose", "transform", "")
"""Where a pose may be in a message: position and orientation, or translation and rotation, stand below."""
_LIST_PATHS = ("poses[].pose", "poses[]")
"""Where the poses of a path are, each with a stamp of its own."""
_POSE_RANK = {"nav_msgs/Odometry": 3, "geometry_msgs/PoseWithCovarianceStamped": 2, "geometry_msgs/PoseStamped": 1}
TF_TYPES = (
    *("tf2_msgs/TFMessage", "tf/tfMessage", "foxglove.FrameTransform", "foxglove.FrameTransforms"),
    *("foxglove_msgs/FrameTransform", "foxglove_msgs/FrameTransforms"),
)
_VALUE = re.compile(
    r"(?i)(?:(?:uwb|tof|twr|raw|slant|measured|est)_?)?(?:range|ranges|dist|dis|distance|distances|dis_arr|dists|"
    r"node_dis|range_m|range_mm|distance_m|distance_mm|dist_mm|dist_cm|range_cm|ranging|tof_distance|"
    r"(?:range|distance|dist)_?(?:3d|(?:from|to)_?(?:tag|anchor|beacon)))"
)
_A_NAMES = (
    "from_id",
    "from",
    "src",
    "src_id",
    "source",
    "source_id",
    "initiator",
    "initiator_id",
    "requester",
    "requester_id",
    "requesterid",
    "origin_id",
    "originid",
    "ido",
    "tag",
    "tag_id",
    "tagid",
    "self_id",
    "self",
    "my_id",
    "own_id",
    "sender_id",
    "sender",
    "tx_id",
    "a",
    "a_id",
    "node_a",
    "id_a",
    "robot_a",
    "id1",
    "id_1",
    "device_id",
    "module_id",
    "local_id",
    "host_id",
)
_B_NAMES = (
    "to_id",
    "to",
    "dst",
    "dst_id",
    "dest",
    "dest_id",
    "destination",
    "destination_id",
    "destinationid",
    "target",
    "target_id",
    "responder",
    "responder_id",
    "responderid",
    "anchor",
    "anchor_id",
    "anchorid",
    "idd",
    "remote",
    "remote_id",
    "other",
    "other_id",
    "peer",
    "peer_id",
    "neighbor",
    "neighbor_id",
    "neighbour_id",
    "receiver_id",
    "receiver",
    "rx_id",
    "b",
    "b_id",
    "node_b",
    "id_b",
    "robot_b",
    "id2",
    "id_2",
    "node_id",
    "node_ids",
    "beacon_id",
    "beacon",
)
_ID_NAMES = ("id", "name", "address", "addr", "node", "ids")
_ANCHOR_PLACE = re.compile(r"(?i)(anchor|beacon|responder)_?(position|location|pos|coordinates?|coords?)")
_RX_NAMES = ("rx_rssi", "rx_power", "rxpower", "rssi", "rss", "rx_level", "rxp")
_FP_NAMES = ("fp_rssi", "fp_power", "fppower", "fpp", "first_path_power", "fp_level")


@dataclass(frozen=True)
class PoseRole:
    """A topic of somebody's poses."""

    topic: Topic
    path: str
    user: str
    is_truth: bool
    time: str
    """A field's path, or `log`."""

    @property
    def is_path(self) -> bool:
        """Whether each message holds a list of poses."""
        return "[]" in self.path


@dataclass(frozen=True)
class RangeRole:
    """A topic of ranges. `a` and `b` are paths of fields, or names after an equals sign; `b` may be `#`, an index."""

    topic: Topic
    value: str
    a: str
    b: str
    unit: str | None
    """None: m for real numbers, mm for integers, unless they are larger than any distance."""
    time: str
    optional: Mapping[str, str]
    """Paths of sigma, rx_power, fp_power, nlos, antenna_a, antenna_b."""
    place: tuple[str, str, str] | None = None
    """Paths of x, y and z (m) of where `b` was surveyed to be."""


@dataclass(frozen=True)
class Roles:
    """What is taken, and why the rest is not."""

    poses: tuple[PoseRole, ...]
    ranges: tuple[RangeRole, ...]
    transforms: tuple[Topic, ...]
    rest: Mapping[str, str]
    """Why a topic is not read."""


First = Callable[[Topic], Any]
"""The first message of a topic; None where it has none."""


def roles_of(topics: list[Topic], mapped: Mapped, first: First, place: str) -> Roles:
    """What each topic is, as said, or else as guessed. Raises InputError for a topic that was said and is not there."""
    names = {topic.name for topic in topics}
    for name in mapped.topics:
        if name not in names:
            raise InputError("--topic", f"{place} has no topic {quoted(name)}: --list shows those that there are")
    poses: list[PoseRole] = []
    ranges: list[RangeRole] = []
    transforms: list[Topic] = []
    rest: dict[str, str] = {}
    pose_topics = [t for t in topics if t.count and _kind(t, mapped) in ("pose", "truth")]
    users = _users(pose_topics, first)
    for topic in topics:
        said = mapped.topics.get(topic.name, {})
        kind = _kind(topic, mapped)
        if not topic.count:
            rest[topic.name] = "has no message"
        elif kind in ("pose", "truth"):
            path = said.get(kind) or _pose_path(topic)
            if path is None or not _has_pose(topic, path):
                raise InputError("--topic", f"{topic.name} has no position and orientation at {quoted(path or '')}")
            time = _time(topic, said, path.partition("[]")[0] if "[]" in path else "")
            if "[]" in path and "[]" not in time:
                raise InputError("--topic", f"{topic.name} has poses at {quoted(path)}, and no stamps with them")
            poses.append(PoseRole(topic, path, said.get("user", users[topic.name]), kind == "truth", time))
        elif kind == "tf":
            transforms.append(topic)
        elif kind == "range":
            role = _range_role(topic, said, first)
            if role is None:
                field = said.get("range") or _value_path(topic)
                rest[topic.name] = f"may have ranges, not of whom: say --topic '{topic.name} range={field} a=WHO b=WHO'"
            else:
                ranges.append(role)
        else:
            rest[topic.name] = kind
    return Roles(tuple(poses), tuple(ranges), tuple(transforms), rest)


def _kind(topic: Topic, mapped: Mapped) -> str:
    """pose, truth, tf, range, or why it is none of them."""
    said = mapped.topics.get(topic.name, {})
    for kind in ("skip", "pose", "truth", "tf", "range"):
        if kind in said:
            return "as asked" if kind == "skip" else kind
    if topic.unread:
        return topic.unread
    if topic.type in TF_TYPES:
        return "tf"
    if not topic.fields:
        return f"a type whose definition is not known ({topic.type}): name its .msg files in a map"
    if topic.type in ("sensor_msgs/Range", "synchronizar.Range"):
        return "distances to the ground or an obstacle, by its name" if OBSTACLE_WORDS.search(topic.name) else "range"
    if _pose_path(topic) is not None and not topic.type.startswith(("visualization_msgs/", "geometry_msgs/Polygon")):
        if PLAN_WORDS.search(topic.name):
            return "where to go, not where it is, by its name"
        return "truth" if has_word(topic.name, TRUTH_WORDS) else "pose"
    if _value_path(topic) is not None and not topic.type.startswith(_NO_RANGES):
        return "range"
    return topic.type


_NO_RANGES = ("sensor_msgs/", "nav_msgs/", "visualization_msgs/", "map_msgs/", "geometry_msgs/", "diagnostic_msgs/")


def _pose_path(topic: Topic) -> str | None:
    single = next((path for path in POSE_PATHS if _has_pose(topic, path)), None)
    if single is not None:
        return single
    return next((path for path in _LIST_PATHS if _has_pose(topic, path) and "[]" in _time(topic, {}, "poses")), None)


def _has_pose(topic: Topic, path: str) -> bool:
    paths = {f.path for f in topic.fields}
    dot = f"{path}." if path else ""
    return {f"{dot}position.x", f"{dot}orientation.w"} <= paths or {f"{dot}translation.x", f"{dot}rotation.w"} <= paths


def _time(topic: Topic, said: Mapping[str, str], items: str = "") -> str:
    """Where the stamp of a message is, or of each item of one of its lists; `log` where it has none."""
    if "time" in said and said["time"] != "header":
        return said["time"]
    before = f"{items}[]." if items else ""
    for path in (f"{before}{name}" for name in ("header.stamp", "timestamp", "stamp", "time", "t")):
        is_number = any(f.path == path and f.kind in ("integer", "float") for f in topic.fields)
        if is_number or any(topic.has(f"{path}.{sec}") for sec in SECONDS):
            return path
    return "log"


def _users(topics: list[Topic], first: First) -> dict[str, str]:
    """Whose each topic of poses is, by its name; by its frames where its name says nothing."""
    users = users_of_topics([topic.name for topic in topics])
    for topic in topics:
        if not users[topic.name]:
            users[topic.name] = _user_of_frames(first(topic)) or "robot"
    return users


_FRAMES = re.compile(
    r"(?i)(.*?)[/_]*(base_link|base_footprint|base|body|imu_link|imu|camera_link|odom|map|world|frame)?"
)


def _user_of_frames(message: Any) -> str:
    """The namespace of a message's frames, where they have one: robot1 of robot1/base_link."""
    for frame in (_text(message, "child_frame_id"), _text(message, "header", "frame_id"), _text(message, "frame_id")):
        found = _FRAMES.fullmatch(frame.strip("/"))
        if found and found[1]:
            return found[1].strip("/").replace("/", "_")
    return ""


def _text(message: Any, *path: str) -> str:
    for name in path:
        message = message.get(name) if isinstance(message, Mapping) else getattr(message, name, None)
    return message if isinstance(message, str) else ""


_PLAIN = {
    **dict.fromkeys(("std_msgs/Float32", "std_msgs/Float64"), "data"),
    **dict.fromkeys(("std_msgs/Float32MultiArray", "std_msgs/Float64MultiArray"), "data[]"),
}
"""Types of bare numbers, and where these are; what they are only a topic's name can tell."""
RANGE_WORDS = re.compile(r"(?i)rang|dist|tof|twr|uwb")
"""In the names of topics that may have ranges."""


def _value_path(topic: Topic) -> str | None:
    """The number in a message that is likely a distance: the shallowest by a name that says so."""
    numbers = [f for f in topic.fields if f.kind in ("float", "integer")]
    found = [f.path for f in numbers if _VALUE.fullmatch(_last(f.path))]
    if not found and topic.type in _PLAIN and RANGE_WORDS.search(topic.name):
        found = [_PLAIN[topic.type]]
    return min(found, key=lambda path: (path.count("."), len(path)), default=None)


def _last(path: str) -> str:
    return path.removesuffix("[]").rpartition(".")[2]


def _range_role(topic: Topic, said: Mapping[str, str], first: First) -> RangeRole | None:
    value = said.get("range") or ("distance" if topic.type == "synchronizar.Range" else _value_path(topic))
    if value is None:
        return None
    above = value.rpartition(".")[0]
    a, b = _ends(topic, value, above)
    if topic.type.endswith("MultiArray") and not {"a", "b"} <= said.keys():
        return None  # what its places stand for is nowhere in it
    named = pair_of_topic(topic.name)
    if len(named) < 2 and not (a and b):
        frame = _text(first(topic), "header", "frame_id").strip("/")
        inside = pair_of_topic(frame.replace("/", "_")) if frame else []
        if len(inside) == 2:
            named = inside
        elif named and inside and named[0].lower() not in frame.lower() and not b:
            b = "header.frame_id"  # each message says with whom
        elif inside and not named:
            named = inside
    if not a and not b and len(named) == 2:
        a, b = (f"={name}" for name in named)
    elif b and not a:
        a = f"={named[0]}" if named else "=?"
    elif a and not b and value.endswith("[]"):
        b = "#"
    elif not a and not b and value.endswith("[]"):
        a, b = f"={named[0]}" if named else "=?", "#"
    elif named and not (a and b):
        a, b = a or f"={named[0]}", b or f"={named[-1]}"
    for end in ("a", "b"):
        if end in said:
            text = said[end] if topic.has(said[end]) or said[end] == "#" else f"={said[end]}"
            a, b = (text, b) if end == "a" else (a, text)
    if not a or not b or a == b:
        return None
    optional = {
        key: said[key] for key in ("sigma", "rx_power", "fp_power", "nlos", "antenna_a", "antenna_b") if key in said
    }
    for key, names in (("rx_power", _RX_NAMES), ("fp_power", _FP_NAMES)):
        near = _near(topic, above, names)
        if near and key not in optional:
            optional[key] = near
    unit = said.get("unit") or _unit(topic, value)
    place = None if b.startswith("=?") else _place_path(topic, above)
    return RangeRole(topic, value, a, b, unit, _time(topic, said), optional, place)


def _place_path(topic: Topic, above: str) -> tuple[str, str, str] | None:
    """Where a message says where the anchor is that it has a range to: by a field's name, or an anchor's own place."""
    dot = f"{above}." if above else ""
    numbers = {f.path for f in topic.fields if f.kind in ("float", "integer")}
    named = {path.rpartition(".")[0] for path in numbers if _ANCHOR_PLACE.fullmatch(_last(path.rpartition(".")[0]))}
    own = [above, f"{dot}position"] if "anchor" in f"{topic.type} {topic.name} {above}".lower() else []
    for where in (*sorted(path for path in named if path.startswith(dot)), *own):
        paths = [f"{where}.{axis}".removeprefix(".") for axis in "xyz"]
        if numbers.issuperset(paths):
            return paths[0], paths[1], paths[2]
    return None


def _ends(topic: Topic, value: str, above: str) -> tuple[str, str]:
    """Fields that name the two devices, where there are some."""
    if topic.type == "sensor_msgs/Range":
        return "", ""
    a = _near(topic, above, _A_NAMES) or _near(topic, "", _A_NAMES)
    b = _near(topic, above, _B_NAMES) or _near(topic, "", _B_NAMES)
    alone = _near(topic, above, _ID_NAMES)
    own = _near(topic, "", _ID_NAMES)
    if value.endswith("[]"):
        lists = {f.path for f in topic.fields if f.path.endswith("[]") and f.path.rpartition(".")[0] == above}
        ids = [
            p for p in sorted(lists) if _last(p).lower() in (*_B_NAMES, *_ID_NAMES, "anchor_ids", "tag_ids", "to_ids")
        ]
        b = ids[0] if ids else ("" if b and not b.endswith("[]") else b)
        return a or (own if own and not own.endswith("[]") else ""), b
    if "[]" in value:
        if not b and not alone and topic.has(f"{above}.header.frame_id"):
            b = f"{above}.header.frame_id"
        b = (b if b.startswith(above) else "") or (alone if alone.startswith(above) else "") or b
        return a or (own if "[]" not in own else ""), b
    if a and not b and alone and alone != a:
        b = alone
    if b and not a and own and own != b:
        a = own
    if not a and not b and alone:
        b = alone
    return a, b


def _near(topic: Topic, above: str, names: tuple[str, ...]) -> str:
    """The path of a field right below a path whose name is one of these, the first of them."""
    below = {
        _last(f.path).lower(): f.path
        for f in reversed(topic.fields)
        if f.path.rpartition(".")[0] == above and f.kind in ("integer", "text", "float")
    }
    plain = {name.replace("_", ""): path for name, path in below.items()}
    return next(
        (below.get(n) or plain[n.replace("_", "")] for n in names if n in below or n.replace("_", "") in plain), ""
    )


def _unit(topic: Topic, value: str) -> str | None:
    """As a field's name says it."""
    suffix = re.search(r"_(mm|cm|m)$", _last(value).lower())
    if suffix:
        return suffix[1]
    return "m" if topic.type in ("sensor_msgs/Range", "synchronizar.Range") else None


def kind_of(topic: Topic, path: str) -> str:
    """What a field is; `other` where there is none."""
    return next((f.kind for f in topic.fields if f.path == path), "other")


def preferred(roles: list[PoseRole]) -> PoseRole:
    """Of several topics of one device the one that is likeliest its own SLAM, with the most messages."""

    def rank(role: PoseRole) -> tuple[int, int, int]:
        slam = has_word(role.topic.name, SLAM_WORDS)
        return int(slam), -1 if role.is_path else _POSE_RANK.get(role.topic.type, 0), role.topic.count

    return max(roles, key=rank)


def field_list(fields: tuple[Field, ...]) -> str:
    """The fields of a message for a listing."""
    return ", ".join(f.path for f in fields if not f.path.startswith("header."))
