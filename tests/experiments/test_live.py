from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from support.told import Scripted

from experiments.common.cpu import cpu_seconds, resident_mb, yardstick_seconds
from experiments.common.full_oracle import common_from_world, true_frames_along
from experiments.common.live import arrival_of, fed, first_registered, one_at_a_time, told, written
from experiments.live import following, hours, replays, start
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.geometry import YawFrame
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

AHEAD = np.array([0.0, 0.0, 0.0, 1.0])


def straight(t: list[float]) -> Track:
    """One metre a second along x."""
    stamps = np.array(t)
    return Track(stamps, np.column_stack([stamps, 0.0 * stamps, 0.0 * stamps]), np.tile(AHEAD, (len(t), 1)))


def recording() -> Recording:
    """A second of two people, with a pose at each quarter of it."""
    pair = np.zeros(3, dtype=np.int32), np.ones(3, dtype=np.int32)
    return Recording(
        (User("phone0"), User("phone1", antennas={"front": (0.1, 0.0, 0.0)})),
        {name: straight([0.0, 0.25, 0.5, 0.75]) for name in ("phone0", "phone1")},
        Ranges.of(
            np.array([0.0, 0.3, 0.6]),
            *pair,
            np.array([1.0, 2.0, 3.0]),
            antenna_b=np.array([0, 0, -1], dtype=np.int32),
            source=np.array([0, -1, -1], dtype=np.int32),
        ),
    )


def says(t: float) -> dict[str, tuple[State, YawFrame | None]]:
    """The second user is placed from 0.2 s, registered from 0.4 s, and its frame moves up by 1 m/s."""
    state = State.REGISTERED if t > 0.35 else State.UNOBSERVABLE
    frame = YawFrame(1.0, 0.0, t, 0.5 * np.pi, 2.0) if t > 0.15 else None
    return {"phone0": (State.REGISTERED, YawFrame()), "phone1": (state, frame)}


def test_everything_is_fed_before_the_update_that_is_later() -> None:
    estimator = Scripted(says)
    calls = [(0.25, lambda e: e.new_session("phone1"))]
    moments = list(fed(recording(), estimator, calls=calls))
    assert [round(m.t, 9) for m in moments] == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    assert estimator.given[:4] == [
        ("phone0", 0.0, 0.0, 0.0, 0.0),
        ("phone1", 0.0, 0.0, 0.0, 0.0),
        ("phone0", "phone1", 0.0, 1.0, {"antenna_b": "front", "source": "module"}),
        ("advance", 0.1),
    ]
    at = estimator.given.index(("new session", "phone1"))
    assert estimator.given[at - 1 : at + 4] == [
        ("advance", 0.2),
        ("new session", "phone1"),
        ("phone0", 0.25, 0.25, 0.0, 0.0),
        ("phone1", 0.25, 0.25, 0.0, 0.0),
        ("advance", 0.3),
    ]


def test_poses_that_come_late_are_fed_late() -> None:
    estimator = Scripted(says)
    late = {"phone1": np.array([0.31, 0.32, 0.33, 0.5])}
    list(fed(recording(), estimator, arrivals=late))
    assert estimator.given.index(("phone1", 0.25, 0.25, 0.0, 0.0)) > estimator.given.index(("advance", 0.3))


def test_a_pose_is_told_by_the_registration_before_it() -> None:
    estimator, played = Scripted(says), recording()
    of = told(played, fed(played, estimator), estimator)
    poses = written(of, played.tracks["phone1"], "phone1")
    assert poses.registered.tolist() == [False, False, True, False]  # the last comes after all updates
    assert np.isnan(poses.position[[0, 3]]).all()
    np.testing.assert_allclose(poses.position[1], [1.0, 0.5, 0.2], atol=1e-9)  # turned by a quarter, twice as far
    np.testing.assert_allclose(poses.position[2], [1.0, 1.0, 0.5], atol=1e-9)
    assert first_registered(of, "phone1") == pytest.approx(0.4)
    assert first_registered(of, "phone0") == pytest.approx(0.1)
    assert of.events[0] == (pytest.approx(0.1), "it is 0.1")


def test_by_the_wall_clock_it_is_never_ahead_of_the_data() -> None:
    estimator = Scripted(says)
    behind = [m.behind for m in fed(recording(), estimator, until=0.2, real_time=True)]
    assert len(behind) == 2
    assert min(behind) >= 0.0


def test_a_stray_stamp_comes_with_its_neighbour() -> None:
    assert arrival_of(straight([0.0, 1.7e9, 1.7e9 + 0.5])).tolist() == [1.7e9 - 1.0, 1.7e9, 1.7e9 + 0.5]
    assert arrival_of(straight([5.0, 5.5, 86400.0])).tolist() == [5.0, 5.5, 6.5]
    assert arrival_of(straight([5.0, 5.5, 6.0])).tolist() == [5.0, 5.5, 6.0]


def test_cpu_time_counts_processes_that_run_and_that_have_ended() -> None:
    spin = "import time\nwhile time.process_time() < 0.3: pass\n"
    before = cpu_seconds()
    subprocess.run([sys.executable, "-c", spin], check=True)
    ended = cpu_seconds()
    with subprocess.Popen([sys.executable, "-c", spin + "print(flush=True); input()"], **PIPES) as process:
        assert process.stdout is not None
        process.stdout.readline()
        running, with_it = cpu_seconds(), resident_mb()
        process.communicate(b"\n")
    assert ended - before > 0.25
    assert running - ended > 0.25
    assert with_it > resident_mb()
    assert yardstick_seconds() > 0.0


PIPES = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}


def test_each_task_has_a_process_of_its_own() -> None:
    assert len({*one_at_a_time(process_of, [1, 2]), os.getpid()}) == 3


def process_of(_: int) -> int:
    time.sleep(0.0)
    return os.getpid()


def test_the_row_of_starts_takes_the_moment_when_all_are_registered() -> None:
    t = np.arange(1, 31) / 10.0
    walk = start.Start(2.0, 0.5, np.array([1.0, 2.0]), 0.001 * np.ones(30), 0.01 * np.arange(30), t, 1)
    row = start.row_of(3, [walk], real_time=True)
    assert row["of the yardstick"] == 4.0
    assert row["median s until registered"] == 1.5
    assert row["s behind when all are registered"] == pytest.approx(0.19)  # at 2.0 s, the twentieth
    assert row["s behind, longest"] == pytest.approx(0.29)
    never = walk._replace(first=np.array([1.0, np.inf]))
    assert start.row_of(3, [never], real_time=True)["at most"] == np.inf


def test_frames_along_a_walk_end_at_the_true_one() -> None:
    simulation = simulate(Scene(users=2, seconds=3.0, seed=1, scale_sigma=0.1, drift_rad_per_sqrt_s=0.05))
    true = common_from_world(simulation, "phone0") @ simulation.world_from_user["phone1"]
    along = true_frames_along(simulation, "phone0", "phone1")
    np.testing.assert_allclose(along[-1], [true.x, true.y, true.z, true.yaw], atol=1e-9)
    assert np.ptp(along[:, 3]) > 0.01


def test_what_followers_tell_is_set_beside_the_true_frames() -> None:
    simulation = simulate(Scene(users=2, seconds=3.0, seed=1))
    true = common_from_world(simulation, "phone0") @ simulation.world_from_user["phone1"]
    off = replace(true, x=true.x + 0.3)

    def one_off(_: float) -> dict[str, tuple[State, YawFrame | None]]:
        return {"phone0": (State.REGISTERED, YawFrame()), "phone1": (State.REGISTERED, off)}

    estimator = Scripted(one_off)
    of = told(simulation.recording, fed(simulation.recording, estimator), estimator)
    found = following.judged(simulation, of)
    np.testing.assert_allclose(found.common, 0.09)
    np.testing.assert_allclose(found.transfer, 0.09)
    np.testing.assert_allclose(found.normalised, 0.09 / 0.01 / 3.0)  # covariance 0.01 each
    assert found.first == [pytest.approx(0.1)]
    assert (found.wrong, len(found.settled)) == (0, 0)
    row = following.row_of(2, 0.0, [found, found])
    assert [row["transfer xy"], row["common xy"]] == pytest.approx([0.3, 0.3])
    assert np.isnan(row["settled xy"])
    assert row["normalised error"] == pytest.approx(3.0)


def test_transfer_is_where_the_first_sees_the_second() -> None:
    pairs = np.array([(0, 1), (1, 0)]).T
    true = np.array([[2.0, 2.0, 0.0, 0.0], [3.0, 2.0, 0.0, 0.0]])
    elsewhere = true + np.array([5.0, -1.0, 3.0, 0.0])  # together: nobody sees that
    np.testing.assert_allclose(hours.transfer(elsewhere, true, pairs), 0.0)
    turned = true + np.array([[0.0, 0.0, 0.0, 0.5 * np.pi], [0.0, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(hours.transfer(turned, true, pairs), [np.sqrt(2.0), 0.0])


def test_an_hour_s_clocks_run_off_and_its_rates_can_be_a_tenth() -> None:
    task = hours.Task(users=2, seed=3, minutes=0.5, slower=10.0)
    simulation = hours.simulation_of(task)
    for name, track in simulation.recording.tracks.items():
        true = simulation.truth[name]
        ppm = 1e6 * ((track.t[-1] - track.t[0]) / (true.t[-1] - true.t[0]) - 1.0)
        assert 0.1 < abs(ppm) < hours.PPM
        assert np.diff(true.t) == pytest.approx(1.0 / 3.0)
    assert len(simulation.recording.ranges) == pytest.approx(0.8 * 30.0, abs=1)


def test_a_row_of_hours_is_by_quarters() -> None:
    wall = np.repeat([9e-3, 1e-3, 5e-3, 2e-3], 10)
    errors = np.repeat([[0.4, 0.4], [0.1, 0.1], [0.2, np.nan], [0.3, 0.6]], 5, axis=0)
    found = hours.Long(wall, np.arange(5.0), 0.1, np.arange(20.0), errors, np.array([True, False]), 0.2, np.ones(20))
    row = hours.row_of(hours.Task(2, 0, 1.0, 1.0), found)
    assert row["last quarter / second"] == pytest.approx(2.0)
    assert row["pairs' transfer xy, quarters"] == "0.400 0.100 0.200 0.474"
    assert [row["with the reference"], row["without"], row["largest"]] == pytest.approx([0.3, 0.6, 0.6])


def test_causal_errors_are_of_what_was_told_from_then_on() -> None:
    played = recording()
    own = played.tracks["phone0"]
    frame = YawFrame(5.0, 3.0, 1.0, 1.0)
    ahead = replace(own, position=own.position + np.array([0.0, 0.4, 0.0]))
    truth = {name: replace(t, position=frame @ t.position) for name, t in (("phone0", own), ("phone1", ahead))}

    def late(t: float) -> dict[str, tuple[State, YawFrame | None]]:
        state = State.REGISTERED if t > 0.45 else State.UNOBSERVABLE
        return {"phone0": (State.REGISTERED, YawFrame()), "phone1": (state, YawFrame())}

    estimator = Scripted(late)
    of = told(played, fed(played, estimator), estimator)
    found = replays.causal(played, truth, of, "phone0", 0.2)
    assert found["causal transfer xy"] == pytest.approx(0.4)
    assert found["least share of it registered"] == 0.5  # poses at 0.25 and 0.5 s
    assert replays.causal(played, truth, of, None, 0.2)["causal transfer xy"] is None
