"""Covariance in the plane of a position on a user's walk."""

from __future__ import annotations

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import UserRegistration

CHI2_95_OF_TWO = -2.0 * np.log(0.05)
"""95 % quantile of the chi-squared distribution with two degrees of freedom, which is exponential."""


def jacobian(user: UserRegistration, place: Array) -> Array:
    """(3, 4) derivative of a position (3,) m on the user's walk, common frame, by its frame's x, y, z and yaw."""
    assert user.common_from_user is not None
    x, y, _ = place - user.common_from_user.translation
    return np.column_stack([np.eye(3), [-y, x, 0.0]])


def plane_covariance(user: UserRegistration, place: Array) -> Array:
    """(2, 2) m^2: covariance of a position (3,) m on the user's walk, common frame; zero where unknown."""
    if user.covariance is None:
        return np.zeros((2, 2))
    if user.static:
        covariance = user.covariance[:2, :2]
    else:
        j = jacobian(user, place)[:2]
        covariance = j @ user.covariance @ j.T
    return covariance if np.isfinite(covariance).all() else np.zeros((2, 2))


def axes_of(covariance: Array) -> tuple[Array, float]:
    """1 sigma (2,) m along the longer and the shorter axis of a covariance (2, 2), and the longer one's angle (rad)."""
    variances, directions = np.linalg.eigh(covariance)
    longer = directions[:, 1]
    return np.sqrt(np.maximum(variances[::-1], 0.0)), float(np.arctan2(longer[1], longer[0]))
