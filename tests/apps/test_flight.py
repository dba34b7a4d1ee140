from __future__ import annotations

from math import dist, hypot

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synchronizar.apps.catch.flight import GRAVITY, Flight, throw_to

PLACES = st.tuples(*3 * [st.floats(-6.0, 6.0)])
SPEEDS = st.tuples(*3 * [st.floats(-8.0, 8.0)])


@given(PLACES, SPEEDS)
def test_a_flight_is_what_steps_under_gravity_add_up_to(place: tuple[float, ...], speed: tuple[float, ...]) -> None:
    position, velocity, dt = np.array(place), np.array(speed), 1e-3
    for _ in range(1000):  # the middle of each step is exact for a constant acceleration
        position = position + velocity * dt + 0.5 * np.array([0.0, 0.0, -GRAVITY]) * dt * dt
        velocity = velocity + np.array([0.0, 0.0, -GRAVITY]) * dt
    flight = Flight(100.0, (place[0], place[1], place[2]), (speed[0], speed[1], speed[2]))
    assert flight.at(101.0) == pytest.approx(position, abs=1e-9)
    assert flight.velocity_at(101.0) == pytest.approx(velocity, abs=1e-9)


@given(PLACES, SPEEDS, st.floats(0.0, 3.0))
def test_a_ball_lands_where_its_height_is_the_floors(
    place: tuple[float, float, float], speed: tuple[float, float, float], drop: float
) -> None:
    floor = place[2] - drop
    lands = Flight(5.0, place, speed).lands(floor)
    assert lands >= 5.0
    assert Flight(5.0, place, speed).at(lands)[2] == pytest.approx(floor, abs=1e-9)


def test_a_ball_that_begins_below_the_floor_has_landed_unless_it_flies_up() -> None:
    assert Flight(5.0, (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)).lands(0.0) == 5.0


@given(PLACES, SPEEDS, PLACES, st.floats(0.0, 1.0), st.floats(0.0, 1.5))
def test_the_nearest_moment_is_as_near_as_the_nearest_of_many(
    place: tuple[float, float, float],
    speed: tuple[float, float, float],
    goal: tuple[float, float, float],
    begin: float,
    last: float,
) -> None:
    flight = Flight(0.0, place, speed)
    when, near = flight.nearest(goal, begin, begin + last)
    assert begin <= when <= begin + last
    assert near == pytest.approx(dist(flight.at(when), goal), abs=1e-12)
    tried = min(dist(flight.at(t), goal) for t in np.linspace(begin, begin + last, 500))
    assert near <= tried + 1e-9


@given(PLACES, PLACES, st.floats(4.0, 9.0))
def test_what_is_thrown_to_somebody_comes_there_where_that_speed_is_enough(
    begin: tuple[float, float, float], goal: tuple[float, float, float], speed: float
) -> None:
    velocity = throw_to(begin, goal, speed)
    assert hypot(*velocity) == pytest.approx(speed)
    d, h = hypot(goal[0] - begin[0], goal[1] - begin[1]), goal[2] - begin[2]
    if d > 0.1 and speed**4 - GRAVITY * (GRAVITY * d * d + 2.0 * h * speed * speed) > 1e-6:
        arrives = d / hypot(velocity[0], velocity[1])
        assert Flight(0.0, begin, velocity).at(arrives) == pytest.approx(goal, abs=1e-6)


def test_a_throw_at_a_goal_beyond_reach_goes_towards_it() -> None:
    vx, vy, vz = throw_to((0.0, 0.0, 1.0), (60.0, 0.0, 1.0), 4.0)
    assert vy == 0.0
    assert vx > 0.0
    assert vz == pytest.approx(vx)  # 45 degrees go farthest on the level
