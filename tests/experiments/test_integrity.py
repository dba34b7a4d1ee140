from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("scipy", reason="bounds of shares need scipy")

from experiments.integrity import running
from experiments.integrity.best import told_apart, well_placed
from experiments.integrity.families import ABREAST, BASES, FAMILIES, KINDS, MIXTURE, drawn, tasks
from experiments.integrity.judging import Judged, Task, Verdict, judge, judged_of, line_of
from experiments.integrity.report import ALL, AT_ONCE, LIVE, groups_of, written, wrong_ones
from experiments.integrity.running import all_of
from experiments.integrity.scoring import Episode, Off, Told, episodes, off_by, row_at, share_bounds
from experiments.integrity.trial import TrueWalk
from synchronizar.data.registration import State
from synchronizar.data.survey import SURVEY
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame, apply_frames
from synchronizar.quaternions import IDENTITY
from synchronizar.simulation.simulate import Simulation

RIGHT, FAR, TURNED = Off(0.2, 0.1, 0.1), Off(0.7, 0.1, 0.2), Off(0.1, 0.6, 0.2)


# ---- scoring ----


def standing(*frame: float) -> TrueWalk:
    """Two places of a device, its own origin and 5 m ahead, in a frame that stays."""
    x, y, z, yaw, scale = frame
    own = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    frames = np.tile([x, y, z, yaw], (2, 1))
    return TrueWalk(np.array([0.0, 1.0]), apply_frames(frames, scale * own), np.tile(frame, (2, 1)))


def off(found: YawFrame, true: TrueWalk, reference: YawFrame | None = None, other: TrueWalk | None = None) -> Off:
    told = Told(State.REGISTERED, found, np.diag([0.04, 0.01, 0.01, 0.01]))
    of = Told(State.REGISTERED, reference or YawFrame(), None)
    return off_by(told, of, (true, 1), (other or standing(0.0, 0.0, 0.0, 0.0, 1.0), 1), static=False)


def test_a_turn_is_as_far_off_as_the_walk_goes() -> None:
    """0.1 rad at 5 m: a chord of 2 x 5 m x sin(0.05). There yaw's 0.1 rad adds 0.5 m to 0.1 m across the walk."""
    found = off(YawFrame(1.0, 2.0, 0.0, 0.4), standing(1.0, 2.0, 0.0, 0.3, 1.0))
    assert found.place == pytest.approx(10.0 * math.sin(0.05))
    assert found.yaw == pytest.approx(0.1)
    straight = off(YawFrame(1.0, 2.0, 0.0, 0.0), standing(1.0, 2.0, 0.0, 0.0, 1.0))
    assert straight[:2] == (0.0, 0.0)
    assert straight.sigma == pytest.approx(math.hypot(0.1, 0.5))


def test_height_counts_and_so_does_a_scale() -> None:
    assert off(YawFrame(0.0, 0.0, 0.5), standing(0.0, 0.0, 0.0, 0.0, 1.0)).place == pytest.approx(0.5)
    assert off(YawFrame(scale=1.1), standing(0.0, 0.0, 0.0, 0.0, 1.0)).place == pytest.approx(0.5)


def test_errors_of_the_reference_are_those_of_what_is_seen_through_it() -> None:
    """The reference is taken for turned by 0.1 rad; the other is right in the common frame, 3 m to 8 m ahead of it."""
    other, true = standing(0.0, 0.0, 0.0, 0.0, 1.0), standing(3.0, 0.0, 0.0, 0.0, 1.0)
    seen = off(YawFrame(3.0), true, YawFrame(yaw=0.1), other)
    assert seen.place == pytest.approx(16.0 * math.sin(0.05))
    assert seen.yaw == pytest.approx(0.1)
    both = off(YawFrame(3.0, 1.0), true, YawFrame(0.0, 1.0), other)
    assert both.place == pytest.approx(0.0)


def test_errors_are_metres_whatever_the_reference_counts_in() -> None:
    other = standing(0.0, 0.0, 0.0, 0.0, 0.001)
    assert off(YawFrame(3.5), standing(3.0, 0.0, 0.0, 0.0, 1.0), YawFrame(scale=0.001), other).place == pytest.approx(
        0.5
    )


def test_what_is_wrong_is_a_place_or_a_heading_beyond_the_limit() -> None:
    assert not RIGHT.wrong
    assert FAR.wrong
    assert TURNED.wrong
    assert Off(math.nan, 0.0, 0.1).wrong


def test_the_newest_pose_that_had_come_is_what_the_truth_is_taken_at() -> None:
    n = 5
    walk = TrueWalk(np.arange(n, dtype=float), np.zeros((n, 3)), np.zeros((n, 5)))
    sparse = Track(np.array([0.5, 2.5]), np.zeros((2, 3)), np.tile(IDENTITY, (2, 1)))
    assert [row_at(walk, sparse, t) for t in (0.2, 0.6, 2.4, 2.5, 9.0)] == [0, 0, 0, 2, 2]
    assert row_at(walk, None, 9.0) == 0


def test_an_episode_is_a_stretch_of_registered_updates_and_wrong_where_any_of_it_is() -> None:
    t = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
    found = episodes("bob", t, [None, RIGHT, FAR, FAR, None, RIGHT, RIGHT])
    assert [(e.user, e.begin, e.end, e.off, e.wrong) for e in found] == [
        ("bob", 0.2, 0.5, FAR, True),
        ("bob", 0.6, 0.7, RIGHT, False),
    ]
    assert [e.off_s for e in found] == [pytest.approx(0.2), 0.0]
    assert episodes("bob", t, [None] * 7) == []


@pytest.mark.parametrize(("wrong", "n"), [(0, 1000), (2, 186), (7, 749), (1, 20)])
def test_bounds_are_where_so_many_come_of_chance_once_in_twenty(wrong: int, n: int) -> None:
    low, high = share_bounds(wrong, n)
    at_most = sum(math.comb(n, k) * high**k * (1.0 - high) ** (n - k) for k in range(wrong + 1))
    fewer = sum(math.comb(n, k) * low**k * (1.0 - low) ** (n - k) for k in range(wrong))
    assert at_most == pytest.approx(0.05)
    assert 1.0 - fewer == pytest.approx(0.05 if wrong else 1.0)


def test_known_bounds() -> None:
    """The rule of three; 1 of 20 from tables of Clopper and Pearson; nothing is known of none."""
    assert share_bounds(0, 1000)[1] == pytest.approx(3.0 / 1000.0, rel=0.01)
    assert share_bounds(1, 20) == (pytest.approx(0.0026, abs=5e-5), pytest.approx(0.2161, abs=5e-5))
    assert share_bounds(3, 3)[1] == 1.0
    assert share_bounds(0, 0) == (0.0, 1.0)


# ---- scenes ----


@pytest.mark.parametrize("family", FAMILIES)
def test_the_truth_of_every_scene_is_where_its_tracks_and_ranges_say(family: str) -> None:
    """True frames take honest tracks to true places, and maximum likelihood's ranges are as long as these say."""
    scene = drawn(family, 3)
    truth = scene.trial.truth()
    for name, own in scene.trial.honest.items():
        walk = truth[name]
        placed = apply_frames(walk.frames[:, :4], walk.frames[:, 4:] * own.position)
        np.testing.assert_allclose(placed, walk.position, atol=1e-6)
        assert len(walk.t) == len(own)
    best = scene.trial.best
    if best is not None and SURVEY not in truth:
        assert len(best.recording.ranges) == len(scene.trial.recording.ranges) == len(best.late)
        assert np.abs(free_of_biases(best)[~best.late]).max(initial=0.0) < 0.6


def free_of_biases(simulation: Simulation) -> np.ndarray:
    r = simulation.recording.ranges
    bias = np.array([simulation.range_bias[user.name] for user in simulation.recording.users])
    return simulation.range_errors() - bias[r.a] - bias[r.b]


def test_a_scene_is_the_same_again_and_mixtures_are_of_two_or_three() -> None:
    first, again = drawn(MIXTURE, 5), drawn(MIXTURE, 5)
    assert first.kinds == again.kinds
    np.testing.assert_array_equal(first.trial.recording.ranges.distance, again.trial.recording.ranges.distance)
    mixed = {drawn(MIXTURE, seed).kinds for seed in range(6)}
    assert {len(kinds) for kinds in mixed} == {2, 3}
    assert all(list(kinds) == [name for name in KINDS if name in kinds] for kinds in mixed)


def test_every_family_has_its_turn_and_the_judge_sees_no_seed_of_the_builders() -> None:
    build, judges = tasks("build", 2000), tasks("judge", 2000)
    assert {family for family, _ in build[:60]} == {*KINDS, ABREAST, MIXTURE}
    assert not {seed for _, seed in build} & {seed for _, seed in judges}
    assert tasks("build", 3, first=2) == tasks("build", 5)[2:]
    assert min(seed for _, seed in judges) == BASES["judge"]


def test_maximum_likelihood_itself_cannot_tell_mirror_images_of_straight_walks_apart() -> None:
    assert all(told_apart(drawn("clean", 2).trial, "phone0").values())
    assert not any(told_apart(drawn("lines", 0).trial, "phone0").values())


def test_maximum_likelihood_places_those_who_walk_about() -> None:
    assert all(well_placed(drawn("clean", 2).trial, "phone0").values())
    surveyed = drawn("surveyed", 0).trial
    assert set(well_placed(surveyed, SURVEY)) == set(surveyed.moving)


# ---- the study ----


def made_up(task: Task, version: str = "") -> Judged:
    family, seed = task
    verdicts = [
        Verdict("bob", State.REGISTERED, FAR if seed % 2 else RIGHT, State.UNOBSERVABLE, True),
        Verdict("carol", State.DISCONNECTED, None, State.REGISTERED, None),
        Verdict("dave", State.UNOBSERVABLE, FAR, State.REGISTERED, True, alone=False),
    ]
    found = [Episode("bob", 1.0, 4.0, TURNED, 1.5), Episode("dave", 2.0, 4.0, RIGHT, 0.0)]
    return Judged(family, seed, (family,), version, 2.0, verdicts, found)


def again(task: Task, version: str = "") -> Judged:
    return made_up(task, version)._replace(cpu=9.0)


def test_a_scene_goes_through_a_line_of_the_file() -> None:
    done = made_up(("clean", 3), "v")
    assert judged_of(line_of(done)) == done


def test_scenes_that_a_file_has_are_not_done_again_but_by_another_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "scenes.jsonl"
    asked = [("clean", 1), ("pocket", 2)]
    monkeypatch.setattr(running, "judge", made_up)
    assert [s.seed for s in all_of(asked, file, 1.0, processes=1)] == [1, 2]
    monkeypatch.setattr(running, "judge", again)
    assert [s.cpu for s in all_of([*asked, ("clean", 3)], file, 1.0, processes=1)] == [2.0, 9.0, 2.0]
    assert all_of([("clean", 4)], file, 0.0, processes=1) == []
    assert len(file.read_text().splitlines()) == 3
    monkeypatch.setattr(running, "version", lambda: "another")
    assert [s.cpu for s in all_of(asked, file, 1.0, processes=1)] == [9.0, 9.0]


def test_a_dask_cluster_does_them_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed", reason="scenes on a cluster need dask[distributed]")
    monkeypatch.setattr(running, "judge", made_up)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        asked = tasks("build", 5)
        scenes = all_of(asked, tmp_path / "scenes.jsonl", 1.0, scheduler=cluster.scheduler_address)
    assert sorted((s.family, s.seed) for s in scenes) == sorted(asked)


def test_what_is_counted(tmp_path: Path) -> None:
    """Of four scenes: bob's verdict is wrong in two, his episode in all; bob at once, dave while walking, of two."""
    scenes = [made_up(("clean", seed)) for seed in range(3)] + [made_up(("pocket", 3))]
    clean, pocket, everything = groups_of(scenes)
    assert (clean.name, pocket.name, everything.name) == ("clean", "pocket", ALL)
    assert everything.wrong == {AT_ONCE: (2, 4), LIVE: (4, 8)}
    assert everything.scenes_wrong == {AT_ONCE: (2, 4), LIVE: (4, 4)}
    assert everything.wrong_for_long == (4, 8)
    assert everything.said == {AT_ONCE: (4, 8), LIVE: (4, 8)}
    assert everything.said_alone == {AT_ONCE: (4, 4), LIVE: (0, 4)}
    assert clean.wrong[AT_ONCE] == (1, 3)
    wrong = wrong_ones(scenes)
    assert [(w["family"], w["seed"], w["how"]) for w in wrong[:2]] == [("clean", 1, AT_ONCE), ("pocket", 3, AT_ONCE)]
    text = written(scenes, {"seeds": "build"}, tmp_path / "told")
    assert "while walking: pocket 3 bob: 0.10 m, 0.60 rad at 0.20 m (1 sigma), 1.5 s of 1.0 to 4.0 s" in text
    told = json.loads((tmp_path / "told.json").read_text())
    assert told["rows"][-1]["while walking: wrong"] == 4
    assert told["wrong"][0]["command"] == 'python -m experiments.integrity --scene "clean" 1'
    assert (tmp_path / "told.png").stat().st_size > 10_000


def test_a_scene_is_solved_both_ways() -> None:
    done = judge(("short", 5))
    assert done.crashed == ""
    assert [v.user for v in done.verdicts] == ["phone1"]
    assert all(e.off_s <= e.end - e.begin + 1e-9 for e in done.episodes)
    assert judged_of(line_of(done)) == done
