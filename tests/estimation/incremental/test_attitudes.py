"""While people walk, lever arms are used only where the attitude can be believed."""

from __future__ import annotations

from dataclasses import replace

import pytest
from support.mistakes import unturned, w_first

from synchronizar.data.recording import Recording
from synchronizar.data.user import User
from synchronizar.diagnosis.belief import why_not_believed
from synchronizar.estimation.incremental.replay import replay
from synchronizar.parameters import Parameters
from synchronizar.simulation.simulate import Scene, simulate

WALK = simulate(Scene(users=2, seconds=10.0, seed=6, antennas=1, rate_hz=6.0)).recording


def with_levers(recording: Recording, lever: tuple[float, float, float]) -> Recording:
    users = tuple(replace(user, antennas={"0": lever}) for user in recording.users)
    return replace(recording, users=users)


def test_antennas_of_who_never_tells_its_attitude_are_at_its_origin() -> None:
    walk = replace(WALK, tracks={name: unturned(track) for name, track in WALK.tracks.items()})
    found, at_origin = replay(with_levers(walk, (0.3, 0.0, 0.1))), replay(with_levers(walk, (0.0, 0.0, 0.0)))
    assert found.registration.users["phone1"].common_from_user is not None
    for name, user in at_origin.registration.users.items():
        assert found.registration.users[name].state is user.state
        assert found.registration.users[name].common_from_user == user.common_from_user
    told = [event for update in found.updates for event in update.events if "at its origin" in event]
    assert len(told) == 2


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_quaternions_in_another_order_are_not_believed_and_right_ones_are(seed: int) -> None:
    parameters = Parameters()
    walk = simulate(Scene(users=3, seconds=20.0, seed=seed)).recording
    for track in walk.tracks.values():
        assert why_not_believed(track, "z", parameters) is None
        assert "w x y z" in (why_not_believed(w_first(track), "z", parameters) or "")


def test_users_without_antennas_are_not_judged() -> None:
    walk = replace(WALK, tracks={name: unturned(track) for name, track in WALK.tracks.items()})
    ranges = replace(walk.ranges, antenna_a=walk.ranges.antenna_a * 0 - 1, antenna_b=walk.ranges.antenna_b * 0 - 1)
    users = tuple(User(user.name) for user in walk.users)
    found = replay(replace(walk, users=users, ranges=ranges))
    assert not any("at its origin" in event for update in found.updates for event in update.events)
