"""The method of SynchronizAR (Huo et al., UIST 2018), as a baseline: two users at a time, and frames composed.

A newcomer registers with one user of those who are there already, the one with whom it has most samples; where it
lies beside the others follows by composition (the paper's equation 3). SLAM is trusted, every range is taken for
honest, and there is no word on how sure the answer is. Samples are taken as the paper's modules take them: at
1000 / (80 + 21 n) Hz for n partners, the newest range with the running average of the newest positions. Over how many
the paper does not say; here over those since the last sample. Nor does it say of antennas, whose lever arms are
added here.
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.data.ranging_rate import papers_rate_hz
from synchronizar.data.recording import Recording
from synchronizar.data.registration import RangeVerdicts, Registration, State, UserRegistration
from synchronizar.data.survey import survey_origin
from synchronizar.diagnosis import findings_of
from synchronizar.diagnosis.reasons import with_reasons
from synchronizar.errors import InputError
from synchronizar.estimation.pairwise.solve import LEAST_REDUCED, solve_reduced
from synchronizar.estimation.register import reference_of
from synchronizar.geometry import YawFrame
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import pairs, range_measurements


class PairSamples(NamedTuple):
    """What two users measured together."""

    p_i: Array
    """(n, 3) m: running averages of the one's positions, in its own frame."""
    p_j: Array
    """(n, 3) m: of the other's."""
    distance: Array
    """(n,) m."""
    row: Indices
    """(n,) which range of the recording it is."""


def register_pairwise(
    recording: Recording, reference: str | None = None, parameters: Parameters | None = None
) -> Registration:
    """Where every user's frame lies in the reference's, by the paper's method.

    Raises InputError as `register` does, and where scipy is not installed.
    """
    began = perf_counter()
    parameters = parameters or Parameters()
    if survey_origin(recording.users) is not None:
        raise InputError("--method", "radios were surveyed: the pairwise method composes frames, and takes no survey")
    users, ref = recording.users, reference_of(recording, reference, parameters)
    measured = pair_samples(recording, parameters)
    began_to_solve = perf_counter()
    frames: dict[int, YawFrame] = {ref: YawFrame()}
    with_whom: dict[int, int] = {}
    used: list[Indices] = []
    while tie := _next(measured, frames, [u.static for u in users]):
        known, new = tie
        samples = measured[min(tie), max(tie)]
        p_known, p_new = (samples.p_i, samples.p_j) if known < new else (samples.p_j, samples.p_i)
        frames[new] = frames[known] @ solve_reduced(p_known, p_new, samples.distance).x_from_y
        with_whom[new] = known
        used.append(samples.row)
    told = {}
    for u, user in enumerate(users):
        if u == ref:
            state, reason = State.REGISTERED, "the reference: its frame is the common one"
        elif u in frames:
            state, reason = (
                State.REGISTERED,
                f"registered with {users[with_whom[u]].name}; how sure that is is not known",
            )
        else:
            state, reason = State.DISCONNECTED, f"fewer than {LEAST_REDUCED} ranges to anybody who is registered"
        frame = replace(frames[u], up_b="z" if user.static else user.up) if u in frames else None
        told[user.name] = UserRegistration(user.name, state, reason, frame, None, user.static)
    seconds = {"load": 0.0, "initialise": began_to_solve - began, "solve": perf_counter() - began_to_solve}
    ranges = _range_verdicts(recording, frames, used, parameters)
    registration = Registration(users[ref].name, "rigid", "pairwise", told, (), ranges, seconds)
    return with_reasons(registration, findings_of(recording, parameters))


def pair_samples(recording: Recording, parameters: Parameters) -> dict[tuple[int, int], PairSamples]:
    """The samples of all pairs i < j, taken at the paper's rate for as many partners as there are others."""
    period = 1.0 / papers_rate_hz(len(recording.users) - 1)
    usable = range_measurements(recording, parameters)
    out = {}
    for pair in pairs(usable):
        of_pair = usable[pair.measurements]
        newest = np.append(np.diff(np.floor(of_pair.t / period)) > 0.0, True)
        taken = of_pair[newest]
        p_i = _running_average(recording, pair.i, taken.t, taken.p_i, period)
        p_j = _running_average(recording, pair.j, taken.t, taken.p_j, period)
        out[pair.i, pair.j] = PairSamples(p_i, p_j, taken.distance, taken.row)
    return out


def _running_average(recording: Recording, user: int, t: Array, antenna: Array, seconds: float) -> Array:
    """(n, 3) m: a user's positions in the last `seconds` before each t (n,), on average; the newest one at least.

    The lever to its `antenna` (n, 3), which is known at t, is added.
    """
    if recording.users[user].static:
        return antenna
    track = recording.tracks[recording.users[user].name]
    lever = antenna - track.at(t, np.inf).position
    total = np.vstack([np.zeros(3), np.cumsum(track.position, axis=0)])
    end = np.searchsorted(track.t, t, side="right")
    begin = np.minimum(np.searchsorted(track.t, t - seconds, side="right"), end - 1)
    return np.asarray((total[end] - total[begin]) / (end - begin)[:, None] + lever)


def _next(
    measured: dict[tuple[int, int], PairSamples], frames: dict[int, YawFrame], static: list[bool]
) -> tuple[int, int] | None:
    """Who has a frame that turns with it and who has none, with most samples between them, enough to be solved."""
    ties = [
        (len(samples.row), known, new)
        for pair, samples in measured.items()
        for known, new in (pair, pair[::-1])
        if known in frames and new not in frames and not static[known] and len(samples.row) >= LEAST_REDUCED
    ]
    if not ties:
        return None
    _, known, new = max(ties, key=lambda tie: (tie[0], -tie[2]))
    return known, new


def _range_verdicts(
    recording: Recording, frames: dict[int, YawFrame], used: list[Indices], parameters: Parameters
) -> RangeVerdicts:
    """What was sampled is taken for honest, the rest was not usable; residuals are those of interpolated places."""
    n, samples = len(recording.ranges), range_measurements(recording, parameters)
    samples = samples[np.isin(samples.row, np.concatenate([*used, np.empty(0, dtype=np.int32)]))]
    taken, residual, weight = np.zeros(n, dtype=bool), np.full(n, np.nan), np.zeros(n)
    taken[samples.row], weight[samples.row] = True, 1.0 / parameters.ranges.sigma**2
    places = [np.empty_like(samples.p_i), np.empty_like(samples.p_i)]
    for place, of, own in zip(places, (samples.i, samples.j), (samples.p_i, samples.p_j), strict=True):
        for u, frame in frames.items():
            mine = of == u
            place[mine] = frame @ own[mine]
    residual[samples.row] = samples.distance - np.linalg.norm(places[0] - places[1], axis=1)
    return RangeVerdicts(taken, taken.copy(), weight, residual)
