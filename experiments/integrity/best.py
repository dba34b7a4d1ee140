"""Who could be placed: maximum likelihood from the truth's start, on what can be used."""

from __future__ import annotations

import numpy as np

from experiments.common import full_oracle, walks
from experiments.integrity.trial import Trial
from synchronizar.arrays import Array
from synchronizar.data.survey import SURVEY
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame
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
