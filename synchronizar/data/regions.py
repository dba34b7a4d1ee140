"""The 95 % region of a device's place in space, over time: an ellipsoid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import Registration
from synchronizar.data.updates import Update
from synchronizar.quaternions import quaternions_of_matrices

CHI_95_OF_THREE = 2.7955
"""Square root of the 95 % quantile of the chi-squared distribution with three degrees of freedom."""
LEAST_M, LARGEST_M = 0.05, 20.0
"""Lengths of an axis, so that it can be seen and does not hide everything."""


class Regions(NamedTuple):
    """Ellipsoids in the common frame, about the device, as they were known from n times on."""

    since: Array
    """(n,) s, the first of them -inf where it holds for all times."""
    size: Array
    """(n, 3) m: lengths of the axes."""
    quat_xyzw: Array
    """(n, 4): the axes' attitude."""


UNKNOWN = Regions(np.array([-np.inf]), np.full((1, 3), 0.1), np.array([[0.0, 0.0, 0.0, 1.0]]))
"""A small ball that says where the device is, and nothing of how well that is known."""


def regions_of(registration: Registration, name: str, updates: Sequence[Update]) -> Regions | None:
    """A user's regions at each update of a replay, or of a whole walk's answer one; None where nothing is known."""
    found = [(update.t, update.users[name].covariance) for update in updates]
    if not updates:
        found = [(-np.inf, registration.users[name].covariance)]
    known = [(t, of[:3, :3]) for t, of in found if of is not None and np.isfinite(of[:3, :3]).all()]
    if not known:
        return None
    variances, axes = np.linalg.eigh(np.array([of for _, of in known]))
    axes[:, :, 2] *= np.sign(np.linalg.det(axes))[:, None]  # rotations, no mirror images
    size = np.clip(2.0 * CHI_95_OF_THREE * np.sqrt(np.maximum(variances, 0.0)), LEAST_M, LARGEST_M)
    return Regions(np.array([t for t, _ in known]), size, quaternions_of_matrices(axes))
