"""What is known before any range: of NLOS ranges, of the heights of SLAM origins, of surveys and of devices' faults."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from synchronizar._core import Bursts, NlosMixture
from synchronizar.arrays import Array
from synchronizar.data.user import User
from synchronizar.parameters import Parameters

_NO_SIGMA = 1e3  # m: a survey's zero tells nothing of how high SLAM origins lie


class CalibrationPriors(NamedTuple):
    """Priors of the calibrations of a active users; see `calibration_priors` where they are measured."""

    own: Array
    """(3,) 1 sigma of each device's deviation in log scale, bias (m) and clock offset (s)."""
    common: Array
    """(3,) 1 sigma of what all share."""
    to_told: Array | None = None
    """(3 a, 3 a) takes errors of calibrations under these priors to those that are told, since nobody knows these
    sigmas; None where they are given."""
    usual_variances: Array | None = None
    """(a, 3) posterior variances under the usual priors; None where these are the usual ones."""


def nlos_mixture(parameters: Parameters) -> NlosMixture:
    """The loss of a range under these parameters."""
    return NlosMixture(
        parameters.ranges.detour_scale, parameters.ranges.short_share / (1.0 - parameters.ranges.short_share)
    )


def bursts_of(parameters: Parameters) -> Bursts:
    """The Markov chain of NLOS bursts under these parameters (factors/nlos_bursts.h)."""
    r = parameters.ranges
    return Bursts(r.nlos_share, r.nlos_duration, r.detour_kept, r.detour_fluctuation)


def bursts_with_foreign(parameters: Parameters) -> Bursts:
    """The same chain where ranges may not be of the two devices for some seconds."""
    r = parameters.ranges
    foreign = r.foreign_share, r.foreign_duration, r.foreign_speed, r.foreign_scale, r.foreign_least
    return bursts_of(parameters).with_foreign(*foreign)


def height_sigma_of(user: User, parameters: Parameters) -> float:
    """m, 1 sigma: how far the user's origin may lie above or below another one of its kind."""
    if user.is_survey_origin:
        return _NO_SIGMA
    if user.height_sigma is not None:
        return user.height_sigma
    return parameters.priors.static_height_sigma if user.static else parameters.priors.height_sigma


def survey_of(users: Sequence[User], reference: int) -> Array:
    """(k, 3) m: where surveyed radios are, about the survey's origin, which is the reference; NaN of all others."""
    out, origin = np.full((len(users), 3), np.nan), users[reference].position
    if origin is not None:
        for u, user in enumerate(users):
            if u != reference and user.position is not None:
                out[u] = np.subtract(user.position, origin)
    return out


def survey_sigmas(users: Sequence[User], parameters: Parameters) -> Array:
    """(k,) m, 1 sigma on each axis of a surveyed place; the model's default where nothing is said."""
    return np.array([user.position_sigma or parameters.priors.survey_sigma for user in users])


def known_bias_sigmas(users: Sequence[User], parameters: Parameters) -> Array:
    """(k,) m, 1 sigma of each radio's bias beside the known one; infinite where none is known."""
    default = parameters.devices.known_bias_sigma
    return np.array([user.range_bias_sigma or (np.inf if user.range_bias is None else default) for user in users])


def known_biases(users: Sequence[User]) -> Array:
    """(k,) m: what radios are known to add to a range; 0 where that is not known."""
    return np.array([user.range_bias or 0.0 for user in users])


def calibration_sigmas(parameters: Parameters) -> tuple[Array, Array]:
    """(3,) each, 1 sigma of log scale, bias (m) and clock offset (s): of a device's deviation, of the shared value."""
    m = parameters
    own = np.array([m.devices.scale_sigma, m.devices.bias_sigma, m.devices.clock_sigma])
    return own, np.array([m.devices.scale_common_sigma, m.devices.bias_common_sigma, m.devices.clock_common_sigma])


def calibration_dof(parameters: Parameters) -> Array:
    """(3,) degrees of freedom of Student's t, the prior of log scale, bias and clock offset."""
    return np.array([parameters.devices.scale_dof, parameters.devices.bias_dof, parameters.devices.clock_dof])
