"""Keys of the pose graph's variables."""

from __future__ import annotations

from itertools import pairwise

import gtsam

_MOST_KEYFRAMES = 10**7  # per user: keys are numbered user by user
_MOST_USERS = 10**4  # per slot: keys are numbered slot by slot
_EARLIER = 10**7  # slots before the first range that came: others may have been measured earlier
# A symbol's number stands in its lower bits: these are made ten thousand times a second.
_SLOT_POSE, _SLOT_HEIGHT, _SLOT_CALIBRATION = (int(gtsam.symbol(letter, _EARLIER * _MOST_USERS)) for letter in "xhd")

MEAN_HEIGHT: int = gtsam.symbol("L", 0)
"""double (m): the mean height of all SLAM origins."""
SHARED_CALIBRATION: int = gtsam.symbol("K", 0)
"""Vector (3,): log scale, radio bias (m), clock offset (s) that all devices share; each deviates from it."""


def frame(user: int) -> int:
    """Key of a Pose2: common_from_anchor of a user."""
    return int(gtsam.symbol("F", user))


def height(user: int) -> int:
    """Key of a double (m): height of a user's origin in the common frame."""
    return int(gtsam.symbol("H", user))


def calibration(user: int) -> int:
    """Key of a Vector (3,): log scale, radio bias (m) and clock offset (s) of a user's device."""
    return int(gtsam.symbol("D", user))


def own_height(user: int) -> int:
    """Key of a double (m): the height above a user's origin at which its device is carried."""
    return int(gtsam.symbol("O", user))


def pose(user: int, keyframe: int) -> int:
    """Key of a Pose2: a keyframe in the axes of the user's anchor, SLAM units."""
    return int(gtsam.symbol("X", user * _MOST_KEYFRAMES + keyframe))


def local_height(user: int, keyframe: int) -> int:
    """Key of a double: the keyframe's height, SLAM units."""
    return int(gtsam.symbol("Z", user * _MOST_KEYFRAMES + keyframe))


def slot_pose(user: int, slot: int) -> int:
    """Key of a Pose2: a user's device at the begin of a slot, and SLAM's axes, in the common frame."""
    return _SLOT_POSE + slot * _MOST_USERS + user


def slot_height(user: int, slot: int) -> int:
    """Key of a double (m): the device's height then, in the common frame."""
    return _SLOT_HEIGHT + slot * _MOST_USERS + user


def slot_calibration(user: int, slot: int) -> int:
    """Key of a Vector (3,): log scale, radio bias (m) and clock offset (s) then."""
    return _SLOT_CALIBRATION + slot * _MOST_USERS + user


def rows(keys: list[int]) -> list[slice]:
    """The rows of each key's variable in the stacked vector of all."""
    size = {ord(symbol): 3 for symbol in "FXDKxd"}
    bounds = [0]
    for key in keys:
        bounds.append(bounds[-1] + size.get(gtsam.symbolChr(key), 1))
    return [slice(a, b) for a, b in pairwise(bounds)]


def ordering(keys: list[int]) -> gtsam.Ordering:
    """The keys as a gtsam ordering."""
    out = gtsam.Ordering()
    for key in keys:
        out.push_back(key)
    return out
