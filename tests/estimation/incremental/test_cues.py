from __future__ import annotations

import numpy as np
import pytest

from synchronizar.arrays import Array
from synchronizar.estimation.hypotheses import GaussianComponent, Hypothesis
from synchronizar.estimation.incremental.cues import Cue, cue_of
from synchronizar.parameters import Parameters

MODEL = Parameters()
CORNERS = np.zeros((1, 3))


def placement(covariance: Array) -> Hypothesis:
    frames = np.zeros((2, 4))
    covariances = np.stack([np.zeros((4, 4)), covariance])
    return Hypothesis(0.0, frames, covariances, [GaussianComponent(1.0, frames, covariances)])


def cue(covariance: Array, others: Array, velocity: Array | None = None, before: Cue | None = None) -> Cue | None:
    moving = np.zeros(2) if velocity is None else velocity
    names = [f"other{n}" for n in range(len(others))]
    return cue_of(placement(covariance), 1, np.zeros(3), others, moving, CORNERS, names, before, MODEL)


def covariance(x: float, y: float, yaw: float = 0.05) -> Array:
    return np.diag([x, y, 0.05, yaw]) ** 2


def test_who_is_unseen_across_the_line_to_another_walks_across_it() -> None:
    """Ranges to somebody 5 m ahead see x alone; those from beside the line see y as well."""
    found = cue(covariance(0.05, 0.8), np.array([[5.0, 0.0, 0.0]]))
    assert found is not None
    assert abs(np.sin(found.direction)) > 0.7


def test_the_told_walk_is_the_best_by_brute_force() -> None:
    """What one more range would leave unseen, by adding up information of each walk's ranges."""
    others = np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 0.0]])
    known = covariance(0.3, 0.5, yaw=0.4)
    found = cue(known, others)
    assert found is not None
    sigma2 = MODEL.ranges.sigma**2 + MODEL.ranges.multipath_sigma**2
    left = []
    for phi in np.arange(16) * (2.0 * np.pi / 16):
        information = np.linalg.inv(known)
        for step in np.arange(0.5, 3.01, 0.5):
            away = step * np.array([np.cos(phi), np.sin(phi), 0.0])
            for other in others:
                line = (away - other) / np.linalg.norm(away - other)
                row = np.array([*line, line[1] * away[0] - line[0] * away[1]])
                information += np.outer(row, row) / sigma2
        after = np.linalg.inv(information)
        in_plane = np.sqrt(np.linalg.eigvalsh(after[:2, :2])[-1])
        left.append(max(in_plane / 0.1843, np.sqrt(after[3, 3]) * 2.807 / 0.5))
    assert found.direction == pytest.approx(float(np.arange(16)[int(np.argmin(left))] * 2.0 * np.pi / 16))


def test_nobody_is_sent_anywhere_who_is_seen_well_enough_or_sees_nobody() -> None:
    assert cue(covariance(0.05, 0.05), np.array([[5.0, 0.0, 0.0]])) is None
    assert cue(covariance(0.5, 0.5), np.zeros((0, 3))) is None


def test_a_way_that_is_nearly_as_good_is_kept() -> None:
    others, known = np.array([[5.0, 0.0, 0.0]]), covariance(0.05, 0.8)
    first = cue(known, others)
    assert first is not None
    mirrored = Cue(-first.direction % (2.0 * np.pi), 2.0, "")
    again = cue(known, others, before=mirrored)
    assert again is not None
    assert np.sin(again.direction) == pytest.approx(np.sin(mirrored.direction))


@pytest.mark.parametrize(
    ("heading", "words"), [(0.0, "straight on"), (np.pi, "back"), (-np.pi / 2, "to your left"), (np.pi / 2, "right")]
)
def test_the_sentence_is_in_the_walkers_own_terms(heading: float, words: str) -> None:
    others, known = np.array([[5.0, 0.0, 0.0]]), covariance(0.05, 0.8)
    way = cue(known, others)
    assert way is not None
    turned = way.direction + heading
    told = cue(known, others, velocity=np.array([np.cos(turned), np.sin(turned)]))
    assert told is not None
    assert words in told.sentence
    standing = cue(known, others)
    assert standing is not None
    assert "other0" in standing.sentence
