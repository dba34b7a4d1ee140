from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.common.live import Said
from experiments.live import replay_verdicts
from experiments.live.replay_verdicts import Episode, Judged, all_of, in_sigmas, stretches, upper_bound


def test_an_episode_is_a_stretch_of_registered_updates() -> None:
    registered = np.array([1, 1, 0, 0, 1, 0, 1], dtype=bool)
    assert stretches(registered) == [slice(0, 2), slice(4, 5), slice(6, 7)]
    assert stretches(np.zeros(3, dtype=bool)) == []


def test_errors_are_counted_in_what_is_said_of_them() -> None:
    covariance = np.tile(np.diag([0.01, 0.04, np.nan, 0.01]), (3, 1, 1))
    covariance[2] = np.nan
    frame = np.tile([1.0, 2.0, 3.0, 3.1, 1.0], (3, 1))
    frame[1, 3] = -3.1
    said = Said(np.ones(3, dtype=bool), frame, covariance)
    true = np.array([1.2, 2.0, 0.0, 3.1])  # 2 sigma in x; in yaw the short way round, 0.083 rad
    np.testing.assert_allclose(in_sigmas(said, true), [2.0, 2.0, 0.0])
    np.testing.assert_allclose(in_sigmas(said, np.array([1.0, 2.0, 0.0, 3.1]))[1], 10.0 * (2.0 * np.pi - 6.2))


def test_the_bound_without_any_is_the_rule_of_three() -> None:
    assert upper_bound(0, 1000) == pytest.approx(3.0 / 1000, rel=0.01)
    assert upper_bound(2, 186) == pytest.approx(0.0334, abs=2e-4)
    assert (upper_bound(3, 3), upper_bound(0, 0)) == (1.0, 1.0)


def judged(seed: int) -> Judged:
    return Judged("easy", seed, 0.5, [Episode("easy", seed, "phone1", 3.1, 0.1, 2.5)])


def test_scenes_that_a_file_has_are_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "scenes.jsonl"
    monkeypatch.setattr(replay_verdicts, "judge", judged)
    assert all_of([4, 3], file, 1) == [judged(3), judged(4)]
    monkeypatch.setattr(replay_verdicts, "judge", slowly)
    assert [s.cpu for s in all_of([4, 5], file, 1)] == [0.5, 0.5, 9.0]
    assert len(file.read_text().splitlines()) == 3
    assert [s.seed for s in all_of([7], None, 1)] == [7]


def slowly(seed: int) -> Judged:
    return judged(seed)._replace(cpu=9.0)
