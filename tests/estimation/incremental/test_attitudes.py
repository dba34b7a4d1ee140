"""While people walk, lever arms are used only where the attitude can be believed."""

from __future__ import annotations

from dataclasses import replace

import pytest
from support.mistakes import unturned, w_first
from support.relocalised import walk

from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.diagnosis.belief import why_not_believed
from synchronizar.estimation.incremental.replay import replay
from synchronizar.estimation.incremental.roster import Roster
from synchronizar.parameters import Parameters
from synchronizar.simulation.simulate import Scene, simulate

WALK = simulate(Scene(users=2, seconds=10.0, seed=6, antennas=1, rate_hz=6.0)).recording


def with_levers(recording: Recording, lever: tuple[float, float, float]) -> Recording:
    users = tuple(replace(user, antennas={"0": lever}) for user in recording.users)
    return replace(recording, users=users)


def test_antennas_of_who_never_tells_its_attitude_are_at_its_origin() -> None:
    garbled = replace(WALK, tracks={name: unturned(track) for name, track in WALK.tracks.items()})
    found, at_origin = replay(with_levers(garbled, (0.3, 0.0, 0.1))), replay(with_levers(garbled, (0.0, 0.0, 0.0)))
    assert found.registration.users["phone1"].common_from_user is not None
    for name, user in at_origin.registration.users.items():
        assert found.registration.users[name].state is user.state
        assert found.registration.users[name].common_from_user == user.common_from_user
    told = [event for update in found.updates for event in update.events if "at its origin" in event]
    assert len(told) == 2


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_quaternions_in_another_order_are_not_believed_and_right_ones_are(seed: int) -> None:
    parameters = Parameters()
    right = simulate(Scene(users=3, seconds=20.0, seed=seed)).recording
    for track in right.tracks.values():
        assert why_not_believed(track, "z", parameters) is None
        assert "w x y z" in (why_not_believed(w_first(track), "z", parameters) or "")


def roster_of(tracks: list[Track]) -> Roster:
    users = tuple(User(f"phone{u}", antennas={"0": (0.3, 0.0, 0.1)}) for u in range(len(tracks)))
    roster = Roster(users, 0, Parameters())
    for stream, track in zip(roster.streams, tracks, strict=True):
        assert stream is not None
        for row in zip(track.t.tolist(), track.position.tolist(), track.quat_xyzw.tolist(), strict=True):
            stream.add(*row)
    return roster


def test_where_anothers_attitudes_are_wrong_those_that_tell_nothing_yet_are_used_once_they_do() -> None:
    turns, line = simulate(Scene(users=2, seconds=20.0, seed=2)).recording.tracks["phone0"], walk(2.0, turning=0.1)
    assert roster_of([turns, line]).judge_attitudes() == []
    roster = roster_of([w_first(turns), line, turns])
    assert roster.judge_attitudes() == [0, 1]
    assert [user.antennas["0"] for user in roster.users] == [(0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.1)]
    assert roster.judge_attitudes() == []
    stream = roster.streams[1]
    assert stream is not None
    for row in zip((turns.t + 10.0).tolist(), turns.position.tolist(), turns.quat_xyzw.tolist(), strict=True):
        stream.add(*row)
    assert roster.judge_attitudes() == []
    assert [user.antennas["0"] for user in roster.users] == [(0.0, 0.0, 0.0), (0.3, 0.0, 0.1), (0.3, 0.0, 0.1)]
    assert len(roster.events) == 2


def test_users_without_antennas_are_not_judged() -> None:
    garbled = replace(WALK, tracks={name: unturned(track) for name, track in WALK.tracks.items()})
    own = garbled.ranges
    ranges = replace(own, antenna_a=own.antenna_a * 0 - 1, antenna_b=own.antenna_b * 0 - 1)
    users = tuple(User(user.name) for user in garbled.users)
    found = replay(replace(garbled, users=users, ranges=ranges))
    assert not any("at its origin" in event for update in found.updates for event in update.events)
