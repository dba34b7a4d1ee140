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
from synchronizar.estimation.local_optima import BETTER, Settled, compare, measured, refine
from synchronizar.estimation.outcome import Outcome
from synchronizar.estimation.segments import coarse_interval, search_and_grow
from synchronizar.graph.pose_graph import AnchoredGraph
from synchronizar.graph.step_noise import step_noise
from synchronizar.parameters import Model
from synchronizar.preprocessing.keyframes import STANDING, Keyframes, keyframes_of
from synchronizar.preprocessing.range_measurements import samples_of
from synchronizar.preprocessing.relocalizations import Mended, mend


class Solved(NamedTuple):
    """What solving a recording as a whole leads to."""

    minima: list[Settled]
    """Best first, all that explain the ranges."""
    noise: Array
    """(k, 2) how many times as far as the model says each SLAM drifts, in place and in heading."""
    searched: float
    """By perf_counter: when the search was over."""


def register_full(recording: Recording, reference: int, model: Model) -> Outcome:
    """Everybody's frame, drift, scale, clock and radio bias."""
    mended = {name: mend(track, model) for name, track in recording.tracks.items()}
    smooth = replace(recording, tracks={name: of_user.track for name, of_user in mended.items()})
    minima, noise, searched = solve(smooth, mended, reference, model)
    return outcome(recording, smooth, mended, minima, noise, searched, model)


def solve(smooth: Recording, mended: dict[str, Mended], reference: int, model: Model) -> Solved:
    """The minima of a recording of which nothing is known; its tracks are `mended`."""
    samples = samples_of(smooth, model)
    placed = connected(samples, len(smooth.users), reference)
    samples = samples[np.isin(samples.i, placed)]

    coarse = keyframes_of_all(smooth, mended, coarse_interval(samples, model), model)
    found = search_and_grow(smooth, samples, coarse, placed, reference, model)
    searched = perf_counter()
    fine = keyframes_of_all(smooth, mended, model.keyframe_interval, model)
    graph = AnchoredGraph(smooth, samples, fine, placed, reference, model)
    minima, noise = _refined(smooth, mended, found, graph, model)
    if len(minima) > 1 and minima[1].cost < minima[0].cost - BETTER:  # what ranges are worth may turn their order
        minima, noise = _refined(smooth, mended, [minima[1], *found], graph, model)
    return Solved(minima, noise, searched)


def _refined(
    recording: Recording, mended: dict[str, Mended], found: list[Settled], graph: AnchoredGraph, model: Model
) -> tuple[list[Settled], Array]:
    """The first minimum at the keyframes of `graph`, those others that explain the ranges too, and the noise of SLAM.

    All with the noise (k, 2) that each device's SLAM is found to have.
    """
    best = measured(found[0])
    noise = step_noise(best.graph, best.walks, best.judgement)
    coarse = keyframes_of_all(recording, mended, coarse_interval(graph.samples, model), model, noise)
    fine = keyframes_of_all(recording, mended, model.keyframe_interval, model, noise)
    found = [s._replace(graph=s.graph.with_keyframes(coarse)) for s in found]
    best = best._replace(graph=found[0].graph)
    return compare(found, refine(best, graph.with_keyframes(fine)), model), noise


def keyframes_of_all(
    recording: Recording, mended: dict[str, Mended], interval: float, model: Model, noise: Array | None = None
) -> list[Keyframes]:
    """Of every user. `noise` (k, 2): how many times as far as the model says each SLAM drifts; None: as it says."""
    times = np.ones((len(recording.users), 2)) if noise is None else noise
    return [
        STANDING if user.static else keyframes_of(mended[user.name], interval, model, (place, heading))
        for user, (place, heading) in zip(recording.users, times.tolist(), strict=True)
    ]
