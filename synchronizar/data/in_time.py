"""A recording in the order of time, as it would have come."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from synchronizar.data.recording import Recording

A_SECOND = 10
"""Updates of a recording that is played back, at most."""


def in_time(recording: Recording) -> Iterator[tuple[float, int, int]]:
    """When, whose pose (-1: a range), and which row; of the same time poses first."""
    whose = [np.full(len(recording.ranges), -1)]
    t, row = [recording.ranges.t], [np.arange(len(recording.ranges))]
    for u, user in enumerate(recording.users):
        if not user.static:
            track = recording.tracks[user.name]
            t.append(track.t)
            whose.append(np.full(len(track), u))
            row.append(np.arange(len(track)))
    stamps, user_of, row_of = np.concatenate(t), np.concatenate(whose), np.concatenate(row)
    order = np.lexsort([user_of == -1, stamps])
    return zip(stamps[order].tolist(), user_of[order].tolist(), row_of[order].tolist(), strict=True)
