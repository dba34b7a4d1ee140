"""What only a solution shows: clocks seconds off, origins that lie too high or too low, and antenna delays."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np

from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration, State
from synchronizar.diagnosis.adjustment import Adjustment, adjusted
from synchronizar.diagnosis.clock_shift import clock_shift_findings
from synchronizar.parameters import Parameters

CAUSES = frozenset(
    {
        Code.TIME_UNIT,
        Code.RANGE_UNIT,
        Code.TRACK_UNIT,
        Code.UP_AXIS,
        Code.OPTICAL_AXES,
        Code.QUATERNION_ORDER,
        Code.SWAPPED_RADIOS,
    }
)
"""What spoils a solution so that its heights and delays mean nothing."""


def findings_of_solution(
    recording: Recording, registration: Registration, found: Sequence[Finding], parameters: Parameters
) -> list[Finding]:
    """What a solution shows besides what was `found` without it; nothing where that spoils the solution."""
    if spoils(found) or not _suspect(recording, registration, parameters):
        return []
    shifted = clock_shift_findings(recording, parameters)
    if shifted and not _fits_as_it_is(shifted[0], registration):
        return shifted
    adjustment = adjusted(recording, registration, parameters)
    if adjustment is None:
        return []
    return [*_heights(recording, registration, adjustment, parameters), *_biases(recording, adjustment, parameters)]


def spoils(found: Sequence[Finding]) -> bool:
    """Whether something was found that makes a solution meaningless."""
    return any(finding.code in CAUSES for finding in found)


def _fits_as_it_is(of_clock: Finding, registration: Registration) -> bool:
    """Whether the solution places a user by its clock as it is, which NLOS or a slip of its SLAM make look shifted."""
    registered = {name for name, user in registration.users.items() if user.state is State.REGISTERED}
    beside = registered - {registration.reference}
    return bool(beside) if of_clock.user in (None, registration.reference) else of_clock.user in registered


def _suspect(recording: Recording, registration: Registration, parameters: Parameters) -> bool:
    limits = parameters.diagnosis
    high = limits.suspect_share * limits.height_sigmas * parameters.priors.height_sigma
    long = limits.suspect_share * 0.5 * limits.largest_common_bias  # a pair has two biases
    for user in recording.users:
        one = registration.users[user.name]
        if one.state is not State.REGISTERED or abs(one.range_bias) > long:
            return True
        frame = one.common_from_user
        if frame is not None and not user.static and abs(frame.z) > high:
            return True
    return False


def _heights(
    recording: Recording, registration: Registration, adjustment: Adjustment, parameters: Parameters
) -> list[Finding]:
    """Of each moving user whose origin is too far above or below the mean of the others', the farthest first.

    Whose is reported no longer counts among the others. Of two the one that is not the reference is reported.
    """
    level = [u for u, user in enumerate(recording.users) if not user.static and np.isfinite(adjustment.height[u])]
    found, limits = [], parameters.diagnosis
    while len(level) > 1:
        away = {u: _above(adjustment, u, [v for v in level if v != u]) for u in level}
        u = max(level, key=lambda v: (abs(away[v][0]), recording.users[v].name != registration.reference))
        user, (height, sigma) = recording.users[u], away[u]
        allowed = user.height_sigma or parameters.priors.height_sigma
        registered = registration.users[user.name].state is State.REGISTERED
        sigmas = limits.height_sigmas if registered else limits.height_sigmas_lost
        least = limits.height_evidence if registered else limits.height_evidence_lost
        if adjustment.against_heights < least or abs(height) - 0.5 * sigma < sigmas * allowed:
            break
        level.remove(u)
        than = f"{recording.users[level[0]].name}'s" if len(level) == 1 else "the others'"
        side = "higher or lower" if adjustment.either_side else "lower" if height < 0.0 else "higher"
        found.append(
            Finding(
                Code.HEIGHT,
                user.name,
                f"its origin would have to lie {abs(height):.1f} m {side} than {than} (1 sigma {sigma:.2f} m) for its "
                f"ranges to fit, which its height_sigma of {allowed:g} m does not allow",
                f"if it was started at another height, write `height_sigma = {ceil(10.0 * abs(height)) / 10.0:.1f}` "
                f"under [users.{user.name}] in recording.toml",
            )
        )
    return found


def _above(adjustment: Adjustment, u: int, others: list[int]) -> tuple[float, float]:
    """How far (m) a user's origin lies above the mean of the others', and 1 sigma of that."""
    height = float(adjustment.height[u] - adjustment.height[others].mean())
    spread = float(np.sqrt(np.sum(adjustment.height_sigma[others] ** 2))) / len(others)
    return height, float(np.hypot(adjustment.height_sigma[u], spread))


def _biases(recording: Recording, adjustment: Adjustment, parameters: Parameters) -> list[Finding]:
    """Of the delay that all ranges have in common (user None), and of each radio that differs from the others."""
    limits = parameters.diagnosis
    if adjustment.against_biases < limits.bias_evidence:
        return []
    found = []
    mean = adjustment.mean_bias
    if abs(mean) > limits.largest_common_bias:
        found.append(
            Finding(
                Code.RANGE_BIAS,
                None,
                f"ranges are likely too {'long' if mean > 0.0 else 'short'} by {abs(mean):.2f} m on average: the "
                "radios' antenna delays are likely not calibrated",
                f"calibrate them, or {'subtract' if mean > 0.0 else 'add'} {abs(mean):.2f} m "
                f"{'from' if mean > 0.0 else 'to'} the column range",
            )
        )
    there = np.flatnonzero(np.isfinite(adjustment.bias))
    if len(there) < 3:
        return found
    common = float(np.median(adjustment.bias[there]))
    for u in there.tolist():
        own = float(adjustment.bias[u] - common)
        if abs(own) > max(limits.largest_own_bias, limits.own_bias_sigmas * float(adjustment.bias_sigma[u])):
            name = recording.users[u].name
            found.append(
                Finding(
                    Code.RANGE_BIAS,
                    name,
                    f"its radio likely makes ranges {abs(own):.2f} m {'longer' if own > 0.0 else 'shorter'} than the "
                    f"others' do (1 sigma {adjustment.bias_sigma[u]:.2f} m)",
                    "calibrate its antenna delay",
                )
            )
    return found
