"""What is known before any range: how NLOS ranges are distributed, how high SLAM origins lie."""

from __future__ import annotations

from synchronizar._core import Bursts, NlosMixture
from synchronizar.data.user import User
from synchronizar.parameters import Parameters


def nlos_mixture(parameters: Parameters) -> NlosMixture:
    """The loss of a range under these parameters."""
    return NlosMixture(
        parameters.ranges.detour_scale, parameters.ranges.short_share / (1.0 - parameters.ranges.short_share)
    )


def bursts_of(parameters: Parameters) -> Bursts:
    """The Markov chain of NLOS bursts under these parameters (factors/nlos_bursts.h)."""
    r = parameters.ranges
    return Bursts(r.nlos_share, r.nlos_duration, r.detour_kept, r.detour_fluctuation)


def height_sigma_of(user: User, parameters: Parameters) -> float:
    """m, 1 sigma: how far the user's origin may lie above or below another one of its kind."""
    if user.height_sigma is not None:
        return user.height_sigma
    return parameters.priors.static_height_sigma if user.static else parameters.priors.height_sigma
