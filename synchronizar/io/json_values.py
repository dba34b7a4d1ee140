"""Numbers, frames and covariances as registration.json and updates.jsonl hold them, written and read.

Lengths m, angles rad. JSON has no NaN: null stands for a number that is not known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.user import User
from synchronizar.geometry import YawFrame

PLACE = ("x", "y", "z", "yaw")
"""Keys of a frame `common_from_user`, in the order of its covariance."""
MALFORMED = (ValueError, OverflowError, RecursionError, KeyError, TypeError, AttributeError)
"""What reading raises where JSON is broken, or a value is missing or of another kind."""


def number_json(x: float) -> float | None:
    """The number; None where it is not finite."""
    return float(x) if np.isfinite(x) else None


def frame_json(frame: YawFrame | None, static: bool) -> dict[str, float | None]:
    """The values of PLACE; None for all of no frame, and for the yaw of a static radio, which has no heading."""
    if frame is None:
        return dict.fromkeys(PLACE)
    return dict(zip(PLACE, (frame.x, frame.y, frame.z, None if static else frame.yaw), strict=True))


def covariance_json(covariance: Array | None) -> list[list[float | None]] | None:
    """The rows of a covariance (4, 4); None where there is none."""
    return None if covariance is None else [[number_json(x) for x in row] for row in covariance]


def read_finite(value: Any) -> float:
    """The finite number. Raises one of MALFORMED for anything else."""
    number = float(value)
    if not np.isfinite(number):
        raise ValueError(value)
    return number


def read_number(value: Any) -> float:
    """The number; NaN for null."""
    return np.nan if value is None else float(value)


def read_numbers(values: Sequence[Any]) -> Array:
    """(n,) numbers; NaN for each null."""
    return np.array([read_number(value) for value in values])


def read_frame(values: Mapping[str, Any], user: User, scale: float = 1.0) -> YawFrame:
    """The user's frame with the values of PLACE; a static radio's is not turned and has z up.

    Raises one of MALFORMED where the values are none of a frame.
    """
    x, y, z = (read_finite(values[name]) for name in PLACE[:3])
    if scale <= 0.0:
        raise ValueError(scale)
    return YawFrame(x, y, z, read_finite(values["yaw"] or 0.0), scale, "z" if user.static else user.up)


def read_covariance(rows: Any) -> Array | None:
    """(4, 4), NaN for each null; None for null. Raises one of MALFORMED where it is no such matrix."""
    if rows is None:
        return None
    covariance = np.array(rows, dtype=float)
    if covariance.shape != (4, 4):
        raise ValueError(rows)
    return covariance
