"""The full model: SLAM may drift, jump, have a wrong scale and clock, radios a bias; one graph for all of it."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.estimation.assessment import outcome
from synchronizar.estimation.initialisation import connected
from synchronizar.estimation.local_optima import BETTER, LocalOptimum, compare, refine, with_measured_weights
from synchronizar.estimation.outcome import Outcome
from synchronizar.estimation.segments import coarse_interval, search_and_grow
from synchronizar.graph.pose_graph import PoseGraph
from synchronizar.graph.step_noise import step_noise
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.keyframes import STATIC_KEYFRAME, Keyframes, keyframes_of
from synchronizar.preprocessing.range_measurements import range_measurements
from synchronizar.preprocessing.relocalizations import RepairedTrack, repair_relocalizations


class Solved(NamedTuple):
    """What solving a recording as a whole leads to."""

    minima: list[LocalOptimum]
    """Best first, all that explain the ranges."""
    noise: Array
    """(k, 2) how many times as far as the model says each SLAM drifts, in place and in heading."""
    searched: float
    """By perf_counter: when the search was over."""


def register_full(recording: Recording, reference: int, parameters: Parameters) -> Outcome:
    """Everybody's frame, drift, scale, clock and radio bias."""
    repaired_tracks = {name: repair_relocalizations(track, parameters) for name, track in recording.tracks.items()}
    repaired = replace(recording, tracks={name: of_user.track for name, of_user in repaired_tracks.items()})
    minima, noise, searched = solve(repaired, repaired_tracks, reference, parameters)
    return outcome(recording, repaired, repaired_tracks, minima, noise, searched, parameters)


def solve(
    repaired: Recording, repaired_tracks: dict[str, RepairedTrack], reference: int, parameters: Parameters
) -> Solved:
    """The minima of a recording of which nothing is known; its tracks are `repaired_tracks`."""
    measurements = range_measurements(repaired, parameters)
    active_users = connected(measurements, len(repaired.users), reference)
    measurements = measurements[np.isin(measurements.i, active_users)]

    coarse = keyframes_of_all(repaired, repaired_tracks, coarse_interval(measurements, parameters), parameters)
    found = search_and_grow(repaired, measurements, coarse, active_users, reference, parameters)
    searched = perf_counter()
    fine = keyframes_of_all(repaired, repaired_tracks, parameters.slam.keyframe_interval, parameters)
    graph = PoseGraph(repaired, measurements, fine, active_users, reference, parameters)
    minima, noise = _refined(repaired, repaired_tracks, found, graph, parameters)
    if len(minima) > 1 and minima[1].cost < minima[0].cost - BETTER:  # what ranges are worth may turn their order
        minima, noise = _refined(repaired, repaired_tracks, [minima[1], *found], graph, parameters)
    return Solved(minima, noise, searched)


def _refined(
    recording: Recording,
    repaired_tracks: dict[str, RepairedTrack],
    found: list[LocalOptimum],
    graph: PoseGraph,
    parameters: Parameters,
) -> tuple[list[LocalOptimum], Array]:
    """The first minimum at the keyframes of `graph`, those others that explain the ranges too, and the noise of SLAM.

    All with the noise (k, 2) that each device's SLAM is found to have.
    """
    best = with_measured_weights(found[0])
    noise = step_noise(best.graph, best.states, best.em_weights)
    coarse = keyframes_of_all(
        recording, repaired_tracks, coarse_interval(graph.measurements, parameters), parameters, noise
    )
    fine = keyframes_of_all(recording, repaired_tracks, parameters.slam.keyframe_interval, parameters, noise)
    found = [s._replace(graph=s.graph.with_keyframes(coarse)) for s in found]
    best = best._replace(graph=found[0].graph)
    return compare(found, refine(best, graph.with_keyframes(fine)), parameters), noise


def keyframes_of_all(
    recording: Recording,
    repaired_tracks: dict[str, RepairedTrack],
    interval: float,
    parameters: Parameters,
    noise: Array | None = None,
) -> list[Keyframes]:
    """Of every user. `noise` (k, 2): how many times as far as the model says each SLAM drifts; None: as it says."""
    times = np.ones((len(recording.users), 2)) if noise is None else noise
    return [
        STATIC_KEYFRAME
        if user.static
        else keyframes_of(repaired_tracks[user.name], interval, parameters, (place, heading))
        for user, (place, heading) in zip(recording.users, times.tolist(), strict=True)
    ]
