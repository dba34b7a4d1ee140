"""Tracks whose zero is far below or above where they begin: a map's (UTM, an ellipsoid), not their SLAM's.

How high SLAM origins lie beside one another is known because SLAM begins in people's hands. Where a track begins 300 m
above its zero, that is said of a level near its begin instead; else one percent of scale would move the origin by 3 m.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.parameters import Parameters


def raised_by(recording: Recording, parameters: Parameters) -> Array:
    """(k,) SLAM units: the level near which each track begins where that is not its zero, one for all of one map."""
    first = np.array([0.0 if u.static else recording.tracks[u.name].position[0, 2] for u in recording.users])
    high = np.abs(first) > parameters.priors.highest_begin
    if not high.any():
        return np.zeros(len(first))
    level = float(np.median(first[high]))
    near = np.abs(first - level) <= parameters.priors.highest_begin
    return np.where(high, np.where(near, level, first), 0.0)


def lowered(recording: Recording, raised: Array) -> Recording:
    """The recording with the heights of each track about its level."""
    if not raised.any():
        return recording
    tracks = dict(recording.tracks)
    for user, level in zip(recording.users, raised.tolist(), strict=True):
        if level:
            tracks[user.name] = replace(tracks[user.name], position=tracks[user.name].position - [0.0, 0.0, level])
    return replace(recording, tracks=tracks)
