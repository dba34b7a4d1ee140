"""Walks over bad networks, in simulated time: whatever is lost, delayed and reordered is so by a seed."""

from __future__ import annotations

from itertools import permutations

import numpy as np
from support.bad_network import BAD, House

from synchronizar.geometry import YawFrame
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate


def scene(seconds: float, **settings: object) -> Scene:
    drift = {"drift_m_per_sqrt_s": 0.005, "drift_rad_per_sqrt_s": 0.002}
    return Scene(seconds=seconds, scale_sigma=0.01, bias_sigma=0.03, **drift, **settings)  # type: ignore[arg-type]


def clock_errors(house: House) -> list[float]:
    """s: what the room believes of each device's clock, minus what it is."""
    return [abs(house.room.devices[name].clock.convert(0.0) + walker.ahead) for name, walker in house.walkers.items()]


def test_all_are_registered_and_no_word_is_lost() -> None:
    house = House(simulate(scene(18.0, users=3, seed=4)), BAD, seed=4)
    house.time.run(9.0)
    for walker in house.walkers.values():
        walker.silent = True
    house.time.run(18.0)
    assert house.registered() == set(house.walkers)
    assert max(np.percentile(errors, 95) for errors in house.errors().values()) < 0.5
    assert max(clock_errors(house)) < 0.06
    for a, b in permutations(house.walkers.values(), 2):
        assert a.said >= 17
        assert b.heard[a.name] == list(range(1, a.said + 1))
    assert not any(device.refused for device in house.room.devices.values())


def test_a_network_that_changes_a_page_that_reloads_and_a_reference_that_leaves() -> None:
    house = House(simulate(scene(46.0, users=3, seed=2)), BAD, seed=2)
    house.time.run(15.0)
    assert house.registered() == set(house.walkers)
    reference = house.room.frames.reference
    assert reference is not None
    other, third = sorted(house.walkers.keys() - {reference})
    house.walkers[other].join()  # from another address: the room has not heard that the old connection is dead
    house.time.run(18.0)
    assert house.registered() == set(house.walkers)
    house.walkers[third].vanish()
    house.time.run(20.0)
    house.walkers[third].join()  # the page again, whose SLAM begins anew
    house.walkers[third].new_frame(YawFrame(3.0, -1.0, 0.0, 2.0))
    house.time.run(22.0)
    assert house.registered() == {reference, other}
    house.time.run(34.0)
    assert house.registered() == set(house.walkers)
    house.walkers[reference].vanish()
    house.time.run(46.0)
    assert house.room.frames.reference == reference
    assert {other, third} <= house.registered()
    errors = house.errors(since=36.0)
    assert max(np.percentile(errors[name], 95) for name in (other, third)) < 0.6
    for walker in house.walkers.values():
        assert all((np.diff(heard) > 0).all() for heard in walker.heard.values())
    assert house.walkers[other].heard[reference] != []
    assert max(clock_errors(house)) < 0.06


def test_a_phone_that_sleeps_for_a_minute_while_its_clock_stands_still() -> None:
    house = House(simulate(scene(100.0, users=2, seed=3)), BAD, seed=3)
    sleeper = house.walkers["phone1"]
    house.time.run(15.0)
    assert house.registered() == {"phone0", "phone1"}
    sleeper.asleep = True
    house.time.run(75.0)
    sleeper.asleep = False
    sleeper.ahead -= 60.0
    house.time.run(80.0)
    late = house.room.devices["phone1"].refused
    assert set(late) <= {"old"}
    assert late["old"] <= 4.0 * 60.0  # poses of the seconds in which nobody could tell a stall from a clock
    before = late["old"]
    house.time.run(100.0)
    assert house.room.devices["phone1"].refused["old"] == before
    assert house.registered() == {"phone0", "phone1"}
    assert max(clock_errors(house)) < 0.06
    assert np.percentile(house.errors(since=90.0)["phone1"], 95) < 0.6
