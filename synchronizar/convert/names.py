"""Who is meant: devices' names in topics, frames and radios' numbers."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence


def _words(*lines: str) -> frozenset[str]:
    return frozenset(" ".join(lines).split())


TRUTH_WORDS = _words(
    "vrpn vrpn_client vrpn_client_node vrpn_mocap mocap motion_capture optitrack opti_track vicon qualisys natnet",
    "natnet_ros gt ground_truth groundtruth groundtruth_pose truth true_pose leica rigid_bodies rigidbodies",
    "mocap_node phasespace ground_truth_pose gazebo_ground_truth",
)
"""In the names of topics that tell where a device truly was."""
SLAM_WORDS = _words(
    "slam vio vins vins_estimator visual_slam orb_slam orb_slam2 orb_slam3 openvins ov_msckf svo rovio okvis t265",
    "zed zed2 lio lio_sam fast_lio fastlio kiss visual_odometry imu_propagate basalt rtabmap realsense",
)
"""In the names of topics of a device's own SLAM."""
_GENERIC = (
    TRUTH_WORDS
    | SLAM_WORDS
    | _words(
        "relative absolute anchors tags anchor_array",
        "pose poses odom odometry state states local position local_position global_position mavros node nodes",
        "tracking estimate estimated estimator filtered filter fused ekf camera cam imu sensor sensors uwb tof twr",
        "ss_twr ds_twr range ranges ranging distance distances dist measurement measurements data raw info body base",
        "base_link base_footprint link frame world map odom_combined path trajectory transform tf tf_static stamped",
        "vision vision_pose wheel wheel_odom robot_pose amcl_pose topic ros msg out output uwb_range uwb_ranges",
        "uwb_ranging uwb_distance controller diff_drive_controller diffbot_base_controller navigation localization",
    )
)
OBSTACLE_WORDS = re.compile(
    r"(?i)altitude|altimeter|sonar|ultraso|lidar|laser|rangefinder|distance_sensor|terrarange|garmin|cliff|infrared|"
    r"(?:^|[/_])(?:down|ground|ir|hrlv|lrf|teraranger|sharp|bumper)(?:[/_]|$)"
)
"""In the names of topics of distances to the ground or to what stands in the way."""
PLAN_WORDS = re.compile(
    r"(?i)(?:^|[/_])(?:goal|goals|setpoint|initialpose|plan|plans|planner|planned|waypoints?|cmd|command|target|desired|"
    r"(?:global|local|planned)_path)(?:[/_]|$)"
)
"""In the names of topics of poses that are asked for."""
_BEACONS = re.compile(r"(uwb[_-]?)?(anchors?|an|beacons?|base|station|bs|landmarks?|lm|fixed|static)[_-]?\d*", re.I)
_PAIR = re.compile(r"(.+?)(?:_to_|_and_|_vs_|-to-|->|<->|2(?=[A-Za-z])|-|_)(.+)")


def words_of(topic: str) -> list[str]:
    """The words of a topic that name somebody: no generic ones, none twice."""
    return list(dict.fromkeys(word for word in topic.split("/") if word and word.lower() not in _GENERIC))


def has_word(topic: str, words: Collection[str]) -> bool:
    """Whether one of the words is part of a topic's name."""
    return any(word.lower() in words for word in topic.split("/"))


def users_of_topics(topics: Sequence[str]) -> dict[str, str]:
    """Whose each topic is: what its name has that not all others have too; empty where it says nothing."""
    words = {topic: words_of(topic) for topic in topics}
    distinct = {tuple(of) for of in words.values()}
    shared = set.intersection(*(set(of) for of in distinct)) if len(distinct) > 1 else set()
    found = {}
    for topic, of in words.items():
        own = [word for word in of if word not in shared] or of
        found[topic] = own[0] if own else ""
    if len({tuple(of) for of in words.values()}) > 1 and len(set(found.values())) < len(distinct):
        # Its first word does not tell them apart: all of them do.
        for topic, of in words.items():
            found[topic] = "_".join(word for word in of if word not in shared) or found[topic]
    return found


def pair_of_topic(topic: str) -> list[str]:
    """The devices that a topic of ranges names: two, one or none."""
    words = words_of(topic)
    if len(words) >= 2:
        return words[-2:]
    if not words:
        return []
    stem = re.sub(r"(?i)^(uwb|range|ranging|tof|dist|distance|twr)[_-]", "", words[0])
    parts = _PAIR.fullmatch(stem)
    if parts and all(any(c.isdigit() for c in part) for part in parts.groups()):
        return [parts[1], parts[2]]
    return [words[0]]


def matched(radios: Collection[str], users: Collection[str]) -> dict[str, str]:
    """Whose each radio is: by the same name, by a name within the other, or by the same number at the end.

    Radios whose names say that they stand still are nobody's. By number only where it is one user's and one radio's.
    """
    of: dict[str, str] = {}
    plain = {_plain(user): user for user in users}
    for radio in radios:
        if _plain(radio) in plain:
            of[radio] = plain[_plain(radio)]
    free = [radio for radio in radios if radio not in of and not _BEACONS.fullmatch(radio)]
    for radio in free:
        within = [u for u in users if len(_plain(u)) > 1 and re.search(rf"(?<![a-z0-9]){re.escape(u)}(?![0-9])", radio)]
        if len(within) == 1:
            of[radio] = within[0]
    open_users = [user for user in users if user not in of.values()]
    numbered = _by_number(open_users)
    for number, radio in _by_number([radio for radio in free if radio not in of]).items():
        if number in numbered:
            of[radio] = numbered[number]
    return of


def _by_number(names: Collection[str]) -> Mapping[int, str]:
    """The name of each number that exactly one name ends with."""
    numbers: dict[int, list[str]] = {}
    for name in names:
        if digits := re.search(r"(\d+)\D*$", name):
            numbers.setdefault(int(digits[1]), []).append(name)
    return {number: found[0] for number, found in numbers.items() if len(found) == 1}


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())
