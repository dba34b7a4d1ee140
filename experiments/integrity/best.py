"""Who could be placed: maximum likelihood from the truth's start, on what can be used."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from experiments.common import full_oracle, walks
from experiments.integrity.trial import Trial
from synchronizar.arrays import Array
from synchronizar.data.survey import SURVEY
from synchronizar.data.track import Track
from synchronizar.estimation.mirror_images import reflections
from synchronizar.geometry import YawFrame, apply_frames
from synchronizar.parameters import Parameters
from synchronizar.quaternions import yaw_of_quaternions
from synchronizar.simulation.simulate import Simulation

PLACED_M = 0.15


def well_placed(trial: Trial, reference: str) -> dict[str, bool]:
    """Whether maximum likelihood has the last place of each device that moves within 0.15 m, in the reference's plane.

    It trusts SLAM where nothing is wrong with any device. Nobody where it is not known what could be had.
    """
    best = trial.best
    if best is None:
        return {}
    if reference == SURVEY:
        reference = best.recording.users[-1].name
    others = [name for name in trial.moving if name != reference]
    if _devices_are_right(best):
        errors = _rigid(best, reference, others)
    elif reference in best.recording.tracks and best.recording.users[-1].position is None:
        found, true = full_oracle.oracle(best, reference), full_oracle.true_tracks(best, reference)
        errors = _last_places(found, reference, others) - _last_places(true, reference, others)
    else:
        return {}
    off = np.hypot(errors[:, 0], errors[:, 1])
    return {name: bool(near) for name, near in zip(others, off < PLACED_M, strict=True)}


def told_apart(trial: Trial, reference: str) -> dict[str, bool]:
    """Whether maximum likelihood, which knows what is wrong, knows of one placement of each device, and its heading.

    From the truth it sees neither that a mirror image in somebody's straight walk explains the ranges as well, nor that
    nothing tells the heading of who stands still. Nobody where devices are wrong: drift bends lines.
    """
    best = trial.best
    if best is None or reference == SURVEY or not _devices_are_right(best):
        return {}
    graph = walks.line_of_sight(best, reference, Parameters())
    here = walks.most_likely(graph, walks.true_frames(best, reference))
    odds = graph.measurements.nlos_odds
    cost, limits = graph.cost(here, odds), graph.parameters.integrity
    in_line = NormalDist().inv_cdf(1.0 - 0.5 * limits.wrong_share)
    sure = np.sqrt(graph.covariances(here, odds)[:, 3, 3]) < limits.largest_yaw_error / in_line
    for image in reflections(graph.measurements, here, graph.reference):
        there = walks.most_likely(graph, image)
        if graph.cost(there, odds) < cost + limits.cost_excluded:
            sure &= ~(_apart(best, here, there) > limits.largest_error)
    return {name: bool(sure[best.recording.index(name)]) for name in trial.moving if name != reference}


def _apart(simulation: Simulation, here: Array, there: Array) -> Array:
    """(k,) m in the plane between the last places of devices by two sets of frames (k, 4)."""
    tracks = simulation.recording.tracks
    last = [tracks[u.name].position[-1:] if u.name in tracks else np.zeros((1, 3)) for u in simulation.recording.users]
    own = np.array(last)
    off = apply_frames(here[:, None], own) - apply_frames(there[:, None], own)
    return np.asarray(np.hypot(off[:, 0, 0], off[:, 0, 1]))


def _devices_are_right(best: Simulation) -> bool:
    scene = best.scene
    drifts = scene.drift_m_per_sqrt_s > 0.0 or scene.drift_rad_per_sqrt_s > 0.0 or scene.jumps > 0
    return not (drifts or scene.scale_sigma > 0.0 or any(best.range_bias.values()) or any(best.clock_offset.values()))


def _rigid(best: Simulation, reference: str, others: list[str]) -> Array:
    """(n, 3) m: errors of last places by maximum likelihood that trusts SLAM."""
    which = [best.recording.index(name) for name in others]
    true = walks.true_frames(best, reference)[which]
    found = true + walks.oracle(best, reference, Parameters()).error[which]
    last = [best.recording.tracks[name].position[-1] for name in others]
    return np.array(
        [YawFrame(*f) @ p - YawFrame(*t) @ p for f, t, p in zip(found.tolist(), true.tolist(), last, strict=True)]
    ).reshape(-1, 3)


def _last_places(tracks: dict[str, Track], reference: str, others: list[str]) -> Array:
    """(n, 3) m: where devices are at last, in axes that lie in the reference's last pose."""
    own = tracks[reference]
    x, y, z = own.position[-1].tolist()
    turn = float(yaw_of_quaternions(own.quat_xyzw[-1:])[0])
    places = np.array([tracks[name].position[-1] for name in others]).reshape(-1, 3)
    return np.asarray(YawFrame(x, y, z, turn).inverse() @ places)
