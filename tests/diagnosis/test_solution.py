"""What only a solution shows, and the reasons that follow from findings."""

from __future__ import annotations

import re
from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np
import pytest
from support.mistakes import MISTAKES, OPTICAL, Mistake, delayed, held, of_ranges, of_tracks
from support.paths import SHARED

from synchronizar.arrays import Array, Indices
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.diagnosis import findings_of
from synchronizar.diagnosis.clock_shift import clock_shift_findings
from synchronizar.diagnosis.solution import findings_of_solution
from synchronizar.estimation.incremental.replay import replay
from synchronizar.estimation.pairwise.register import register_pairwise
from synchronizar.estimation.register import register
from synchronizar.io.registration_folder import registration_json
from synchronizar.parameters import Parameters
from synchronizar.quaternions import rotate_by_quaternions
from synchronizar.reporting.tables import registration_table
from synchronizar.simulation.simulate import Scene, simulate


def walk(seed: int, **settings: Any) -> Recording:
    return simulate(Scene(**{"users": 3, "seconds": 20.0, "seed": seed} | settings)).recording


@pytest.mark.parametrize("seed", [0, 1])
def test_a_delay_that_all_radios_have_is_told_with_its_size(seed: int) -> None:
    longer = of_ranges(distance=lambda d: d + 0.6)(walk(seed))
    found = [f for f in register(longer).findings if f.code == "range-bias"]
    assert [f.user for f in found] == [None]
    assert "too long by 0.5" in found[0].message or "too long by 0.6" in found[0].message


@pytest.mark.parametrize(
    "settings",
    [
        {"seed": 0, "late_share": 0.2},
        {"seed": 2, "late_share": 0.2},
        {"seed": 3, "walk": ("line",)},
        {"seed": 4, "users": 2, "static_radios": 3, "links": "star"},
        {"seed": 5, "users": 4, "height_spread": 0.1, "bias_sigma": 0.05, "scale_sigma": 0.03},
    ],
    ids=str,
)
def test_nothing_is_told_of_the_solution_of_a_clean_walk(settings: dict[str, Any]) -> None:
    assert register(simulate(Scene(**{"users": 3, "seconds": 15.0} | settings)).recording).findings == ()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_device_that_is_carried_lower_is_told_with_how_much(seed: int) -> None:
    scene = Scene(users=3, seconds=30.0, seed=seed, height_spread=0.0)
    simulation = simulate(scene)
    r = simulation.recording.ranges
    # Its ranges as they would be 0.9 m lower: the true distances with another height, and the same errors.
    errors = simulation.range_errors()
    truth = dict(simulation.truth)
    truth["phone1"] = replace(
        truth["phone1"], position=truth["phone1"].position - np.array([0.0, 0.0, 0.9]), t=truth["phone1"].t
    )
    moved = replace(simulation, truth=truth)
    true_distance = r.distance - moved.range_errors()
    recording = replace(simulation.recording, ranges=replace(r, distance=true_distance + errors))
    found = [f for f in register(recording).findings if f.code == "height"]
    assert [f.user for f in found] == ["phone1"]
    told = re.search(r"lie (\d\.\d) m lower", found[0].message)
    assert told is not None
    assert float(told[1]) == pytest.approx(0.9, abs=0.25)
    assert "under [users.phone1]" in found[0].remedy


def test_findings_stand_in_the_answer_and_below_the_table() -> None:
    mistake = next(m for m in MISTAKES if m.name == "copied ranges")
    registration = register(mistake.make(walk(0)))
    (finding,) = registration_json(registration)["findings"]
    assert finding["code"] == "repeated-ranges"
    assert registration_table(registration).splitlines()[-1].startswith("repeated-ranges: ")


def test_no_overlap_in_time_is_the_reason_of_who_is_disconnected() -> None:
    registration = register(of_tracks(delayed(81234.5), ("phone1",))(walk(0)))
    assert registration.users["phone1"].state is State.DISCONNECTED
    assert "no range falls within the time of its track" in registration.users["phone1"].reason
    assert registration.users["phone2"].state is State.REGISTERED


def test_a_reference_without_overlap_is_the_reason_of_all_others() -> None:
    registration = register(of_tracks(delayed(81234.5), ("phone0",))(walk(0)))
    for name in ("phone1", "phone2"):
        assert "phone0: no range falls within the time of its track" in registration.users[name].reason


NOT_SECONDS = [m for m in MISTAKES if m.code == "time-unit"]


@pytest.mark.parametrize("mistake", NOT_SECONDS, ids=lambda mistake: mistake.name)
def test_stamps_that_are_no_seconds_are_the_reason_within_a_second_of_work(mistake: Mistake) -> None:
    # 0.03 to 0.17 s for 60 s of walking; it took 2 to 16 s.
    recording = mistake.make(walk(0, seconds=30.0))
    began = process_time()
    registration = register(recording)
    seconds = process_time() - began
    states = {name: user.state for name, user in registration.users.items()}
    assert states.pop("phone0") is State.REGISTERED
    wrong = [name for name in states if {name, None, "phone0"} & set(mistake.users)]
    assert all(states[name] is State.DISCONNECTED for name in wrong)
    assert all("are likely in" in registration.users[name].reason for name in wrong)
    if len(wrong) == len(states):
        assert not registration.ranges.usable.any()
        assert seconds < 1.0


def test_no_overlap_in_time_is_told_within_a_second_of_work() -> None:
    recording = of_tracks(delayed(81234.5))(walk(0, seconds=30.0))
    began = process_time()
    registration = register(recording)
    assert process_time() - began < 1.0
    for name in ("phone1", "phone2"):
        assert registration.users[name].state is State.DISCONNECTED
        assert "no range falls within the time of its track" in registration.users[name].reason


@pytest.mark.parametrize("method", ["replay", "pairwise"])
def test_a_replay_and_the_papers_method_have_findings_and_reasons_too(method: str) -> None:
    recording = of_tracks(delayed(81234.5), ("phone1",))(walk(0, seconds=3.0, users=2))
    registration = register_pairwise(recording) if method == "pairwise" else replay(recording).registration
    assert [(str(f.code), f.user) for f in registration.findings] == [
        ("time-overlap", "phone1"),
        ("clock", "phone1"),
    ]
    assert registration.users["phone1"].state is State.DISCONNECTED
    assert registration.users["phone1"].reason == registration.findings[0].message


@pytest.mark.skipif(not (SHARED / "cases").is_dir(), reason=f"{SHARED} is not there")
def test_a_robot_that_starts_lower_is_told_to_set_its_height_sigma() -> None:
    registration = register(Recording.load(SHARED / "cases/robot_person_0.6"))
    (finding,) = registration.findings
    assert (str(finding.code), finding.user) == ("height", "bot")
    assert "height_sigma" in finding.remedy
    assert registration.users["bot"].state is State.REGISTERED or "height_sigma" in registration.users["bot"].reason


@pytest.mark.parametrize(
    ("seconds", "names"), [(1.5, ("phone1",)), (-3.3, ("phone2",)), (3.0, ("phone0", "phone1", "phone2"))]
)
def test_a_clock_that_is_seconds_off_is_told_with_how_much(seconds: float, names: tuple[str, ...]) -> None:
    found = clock_shift_findings(of_tracks(delayed(seconds), names)(walk(1)), Parameters())
    assert [(str(f.code), f.user) for f in found] == [("clock", names[0] if len(names) == 1 else None)]
    side = "ahead of" if seconds > 0.0 else "behind"
    told = re.search(rf"(\d+\.\d) s {side}", found[0].message)
    assert told is not None
    assert float(told[1]) == pytest.approx(abs(seconds), abs=0.11)


def test_of_who_is_registered_by_its_clock_as_it_is_no_clock_is_told() -> None:
    """As where SLAM began anew, or half of the ranges are NLOS, and a shift takes some of the misfit away."""
    late = of_tracks(delayed(3.0), ("phone1",))(walk(1))
    registration = register(late)
    assert [str(f.code) for f in findings_of_solution(late, registration, [], Parameters())] == ["clock"]
    users = dict(registration.users)
    users["phone1"] = replace(users["phone1"], state=State.REGISTERED)
    found = findings_of_solution(late, replace(registration, users=users), [], Parameters())
    assert "clock" not in [str(f.code) for f in found]


def test_nothing_is_told_of_clocks_that_agree() -> None:
    assert clock_shift_findings(walk(1, late_share=0.3), Parameters()) == []


def test_arms_in_a_robots_axes_on_a_cameras_attitudes_are_told() -> None:
    """The antennas are 0.25 m ahead of everybody: [0.25, 0, 0] where x points ahead, [0, 0, 0.25] where z does."""
    simulation = simulate(Scene(users=3, seconds=20.0, seed=5))
    recording, r = simulation.recording, simulation.recording.ranges

    def ahead(who: Indices) -> Array:
        place = np.zeros((len(r), 3))
        for u, user in enumerate(recording.users):
            mine = who == u
            poses = simulation.truth[user.name].at(r.t[mine], np.inf)
            place[mine] = poses.position + rotate_by_quaternions(poses.quat_xyzw, np.array([0.25, 0.0, 0.0]))
        return place

    noise = 0.1 * np.random.default_rng(0).standard_normal(len(r))
    distance = np.linalg.norm(ahead(r.a) - ahead(r.b), axis=1) + noise
    first = np.zeros(len(r), dtype=np.int32)
    measured = replace(r, distance=distance, antenna_a=first, antenna_b=first)
    for lever, expected in (((0.25, 0.0, 0.0), ["optical-axes"] * 3), ((0.0, 0.0, 0.25), [])):
        users = tuple(replace(user, antennas={"front": lever}) for user in recording.users)
        camera = of_tracks(lambda track: held(track, OPTICAL.T))(replace(recording, users=users, ranges=measured))
        assert [str(f.code) for f in findings_of(camera, Parameters())] == expected
