"""gtsam's keys of anchored pose graphs: which variable is whose."""

from __future__ import annotations

from itertools import pairwise

import gtsam

_MOST_KEYFRAMES = 10**7  # of a user: keys are numbered user by user

MEAN_HEIGHT: int = gtsam.symbol("L", 0)
"""double (m): the height that all origins lie about."""
SHARED_CALIBRATION: int = gtsam.symbol("K", 0)
"""Vector (3,): what all devices of a recording have in common, being of a kind."""


def frame(user: int) -> int:
    """Pose2: where a user's anchor lies in the common frame."""
    return int(gtsam.symbol("F", user))


def height(user: int) -> int:
    """The height (double, m) of its origin there."""
    return int(gtsam.symbol("H", user))


def calibration(user: int) -> int:
    """Vector (3,): its log scale, radio bias (m) and clock offset (s)."""
    return int(gtsam.symbol("D", user))


def pose(user: int, keyframe: int) -> int:
    """Pose2: a keyframe about the anchor, in SLAM's lengths."""
    return int(gtsam.symbol("X", user * _MOST_KEYFRAMES + keyframe))


def local_height(user: int, keyframe: int) -> int:
    """The keyframe's height, in SLAM's lengths."""
    return int(gtsam.symbol("Z", user * _MOST_KEYFRAMES + keyframe))


def rows(keys: list[int]) -> list[slice]:
    """Where each key's rows stand when all stand below each other."""
    size = {ord("F"): 3, ord("X"): 3, ord("D"): 3, ord("K"): 3}
    bounds = [0]
    for key in keys:
        bounds.append(bounds[-1] + size.get(gtsam.symbolChr(key), 1))
    return [slice(a, b) for a, b in pairwise(bounds)]


def ordering(keys: list[int]) -> gtsam.Ordering:
    """Gtsam's own list of keys."""
    out = gtsam.Ordering()
    for key in keys:
        out.push_back(key)
    return out
