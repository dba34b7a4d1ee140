from __future__ import annotations

import asyncio
from math import cos, hypot, pi, sin
from typing import Any

import numpy as np
import pytest
from aiohttp import web
from hypothesis import given
from hypothesis import strategies as st
from support.house import House

from experiments.apps.robot_among_people import Walked, walk
from synchronizar.apps.bodies.body import RosbridgeBody, SimulatedBody
from synchronizar.apps.bodies.drive import STOP, Drive, DriveLimits, Ground, Twist
from synchronizar.apps.bodies.steering import Goal, Person, SteeringParameters, may_move, steer
from synchronizar.apps.robot.game import Robots, order_id
from synchronizar.apps.robot.mirror import Mirror, beside, mirror_between
from synchronizar.apps.robot.pilot import Pilot
from synchronizar.errors import InputError
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.live import messages as m
from synchronizar.live.app_run import hear
from synchronizar.live.stage import Stage

ANGLES = st.floats(-pi, pi)
GROUNDS = st.builds(Ground, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), ANGLES)
MIRRORS = st.builds(Mirror, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), ANGLES)


def apart(a: Ground, b: Ground) -> float:
    return hypot(a.x - b.x, a.y - b.y)


@given(MIRRORS, GROUNDS)
def test_the_image_of_an_image_is_oneself(mirror: Mirror, person: Ground) -> None:
    again = mirror.image(mirror.image(person))
    assert apart(again, person) < 1e-9
    assert abs(wrap_angle(again.heading - person.heading)) < 1e-9


@given(MIRRORS, GROUNDS)
def test_who_walks_forwards_sees_the_image_walk_forwards(mirror: Mirror, person: Ground) -> None:
    step = 0.1
    ahead = Ground(person.x + step * cos(person.heading), person.y + step * sin(person.heading), person.heading)
    image, then = mirror.image(person), mirror.image(ahead)
    expected = image.x + step * cos(image.heading), image.y + step * sin(image.heading)
    assert (then.x, then.y) == pytest.approx(expected, abs=1e-9)
    moved = mirror.turned((ahead.x - person.x, ahead.y - person.y))
    assert moved == pytest.approx((then.x - image.x, then.y - image.y), abs=1e-9)


@given(GROUNDS, GROUNDS)
def test_a_mirror_between_two_shows_the_one_where_the_other_stands(person: Ground, robot: Ground) -> None:
    assert apart(mirror_between(person, robot).image(person), robot) < 1.1e-6  # nearer ones are taken for one place


@given(GROUNDS, GROUNDS, st.floats(0.5, 3.0))
def test_who_comes_stands_at_that_distance_and_looks_at_the_person(person: Ground, robot: Ground, way: float) -> None:
    goal = beside(person, robot, way)
    assert apart(goal, person) == pytest.approx(way)
    assert (goal.x + way * cos(goal.heading), goal.y + way * sin(goal.heading)) == pytest.approx((person.x, person.y))


def test_a_robot_that_turns_while_it_drives_goes_round_in_a_circle_of_that_radius() -> None:
    drive = Drive(Ground(0.0, 0.0, 0.0), 0, DriveLimits(linear_acceleration=1e9, angular_acceleration=1e9))
    for _ in range(1000):
        drive.command(Twist(0.5, 1.0))
        drive.step(2.0 * pi / 1000.0)
    assert apart(drive.truth, Ground(0.0, 0.0, 0.0)) < 1e-3
    for _ in range(500):
        drive.command(Twist(0.5, 1.0))
        drive.step(2.0 * pi / 1000.0)
    assert (drive.truth.x, drive.truth.y) == pytest.approx((0.0, 1.0), abs=1e-3)  # two radii to the left


def test_a_robot_that_hears_nothing_brakes_by_itself() -> None:
    drive = Drive(Ground(0.0, 0.0, 0.0), 0)
    for _ in range(100):
        drive.command(Twist(1.0, 0.0))
        drive.step(0.01)
    for _ in range(60):
        drive.step(0.01)
    assert drive.twist == STOP


@given(GROUNDS, GROUNDS, st.lists(st.tuples(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0)), min_size=1, max_size=1))
def test_no_command_brings_the_steered_point_nearer_to_somebody_than_it_may(
    at: Ground, goal: Ground, people: list[tuple[float, float]]
) -> None:
    p = SteeringParameters()
    person = Person(people[0], (0.0, 0.0), 0.05)
    linear, angular = steer(at, Goal(goal), [person], 0.05, p)
    c, s = cos(at.heading), sin(at.heading)
    velocity = linear * c - p.ahead * angular * s, linear * s + p.ahead * angular * c
    dx, dy = at.x + p.ahead * c - person.place[0], at.y + p.ahead * s - person.place[1]
    distance = hypot(dx, dy)
    room = distance - p.keep - p.ahead - p.sigmas * hypot(0.05, 0.05)
    if distance > 0.05 and -p.yielding * room <= 0.9 * p.retreat:
        grows = (velocity[0] * dx + velocity[1] * dy) / distance
        assert grows >= -p.yielding * room - 1e-6


@pytest.mark.parametrize(
    ("state", "sigma", "age", "may"),
    [
        ("registered", 0.1, 0.1, True),
        ("ambiguous", 0.1, 0.1, False),
        ("registered", 0.6, 0.1, False),
        ("registered", 0.1, 0.4, False),
        ("registered", float("nan"), 0.1, False),
        ("registered", 0.1, float("nan"), False),
    ],
)
def test_a_robot_moves_only_where_it_knows_enough(state: str, sigma: float, age: float, may: bool) -> None:
    assert may_move(state, sigma, age, SteeringParameters()) is may


def test_a_robot_stops_within_three_tenths_of_a_second_of_losing_its_place() -> None:
    drive, pilot = Drive(Ground(0.0, 0.0, 0.0), 0), Pilot()
    pilot.whom = "ann"
    stopped = None
    for n in range(600):
        t = n / 100.0
        if n % 3 == 0:
            pilot.own(t, "registered" if t < 2.0 else "ambiguous", 0.1)
            pilot.person(t, "ann", Ground(6.0, 0.0, pi), 0.05)
        drive.command(pilot.twist(t, drive.truth))
        drive.step(0.01)
        if t >= 2.0 and drive.twist == STOP and stopped is None:
            stopped = t
    assert drive.truth.x > 0.5  # it was on its way
    assert stopped is not None
    assert stopped <= 2.3


def test_among_people_who_walk_with_lost_packets_it_never_comes_nearer_than_half_a_metre() -> None:
    walked: list[Walked] = [walk(seed, 30.0) for seed in range(12)]
    assert min(one.nearest for one in walked) >= 0.5
    # And it does not do so by standing still.
    assert np.median([one.mirror_error for one in walked]) < 1.5


def test_a_simulated_body_goes_as_it_is_told_by_its_clock() -> None:
    now = [100.0]
    body = SimulatedBody(Drive(Ground(0.0, 0.0, 0.0), 0, drift=0.0, drift_rad=0.0), lambda: now[0])

    async def go() -> None:
        for _ in range(20):
            await body.command(Twist(0.5, 0.0))
            now[0] += 0.1
            body.odometry()

    asyncio.run(go())
    assert body.odometry().position[0] == pytest.approx(1.0, abs=0.1)
    assert body.odometry().quat_xyzw == pytest.approx((0.0, 0.0, 0.0, 1.0))


async def _mock(heard: list[Any]) -> tuple[web.AppRunner, str]:
    """What rosbridge does of its protocol: takes words, and says one odometry and some nonsense."""

    async def serve(request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        async for word in socket:
            said = word.json()
            heard.append(said)
            if said["op"] == "subscribe":
                await socket.send_str("nonsense")
                await socket.send_json({"op": "status", "level": "error"})
                await socket.send_json({"op": "publish", "topic": said["topic"], "msg": {"pose": {}}})
                pose = {
                    "position": {"x": 1.0, "y": 2.0, "z": 0.0},
                    "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8},
                }
                await socket.send_json({"op": "publish", "topic": said["topic"], "msg": {"pose": {"pose": pose}}})
        return socket

    app = web.Application()
    app.router.add_get("/", serve)
    runner = web.AppRunner(app)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0).start()
    return runner, f"ws://127.0.0.1:{runner.addresses[0][1]}/"


def test_a_robot_with_ros_is_driven_by_rosbridge_and_stops_when_it_is_let_go() -> None:
    heard: list[Any] = []

    async def go() -> None:
        runner, address = await _mock(heard)
        body = await RosbridgeBody.connect(address, "/wheels/odom", "/base/cmd_vel", lambda: 7.0)
        hearing = asyncio.create_task(body.hear())
        async with asyncio.timeout(20.0):
            while body.odometry() is None:
                await asyncio.sleep(0.01)
        assert body.odometry() == (7.0, (1.0, 2.0, 0.0), (0.0, 0.0, 0.6, 0.8))
        await body.command(Twist(0.3, -0.2))
        await body.close()
        hearing.cancel()
        await runner.cleanup()

    asyncio.run(go())
    assert ("/wheels/odom", "nav_msgs/Odometry") in [(w["topic"], w["type"]) for w in heard if w["op"] == "subscribe"]
    said = [word["msg"] for word in heard if word["op"] == "publish"]
    assert [(msg["linear"]["x"], msg["angular"]["z"]) for msg in said] == [(0.3, -0.2), (0.0, 0.0)]


def test_where_no_rosbridge_answers_the_address_is_named() -> None:
    with pytest.raises(InputError, match="no rosbridge answers"):
        asyncio.run(RosbridgeBody.connect("ws://127.0.0.1:9/"))


class Called:
    """A room with a robot and two people, and the application that gives orders."""

    def __init__(self) -> None:
        self.house = House(app="robot")
        self.clients = {name: self.house.enter(name)[0] for name in ("ann", "bob", "robo")}
        self.app = self.house.enter_app()
        welcome, *_ = self.house.said_to(self.app)
        assert isinstance(welcome, m.Welcome)
        self.stage, self.game = Stage(welcome), Robots()
        self.game.begin(self.stage)

    def go_on(self) -> None:
        self.house.clock.t += 1.0 / 30.0
        for n, client in enumerate(self.clients.values()):
            self.house.pose(client, 3.0 * n)
        self.house.told(ann=YawFrame(), bob=YawFrame(y=2.0), robo=YawFrame())
        self.house.room.tick()
        for word in self.house.said_to(self.app):
            hear(self.game, self.stage, word)
        for said in self.stage.take_words():
            self.house.room.hear(self.app, m.decode_from_client(m.encode(said)))

    def says(self, name: str, topic: str, data: Any = None) -> None:
        self.house.room.hear(self.clients[name], m.Say(topic, data, m.APP))
        self.go_on()

    @property
    def order(self) -> Any:
        return self.house.room.objects.objects[order_id("robo")].data


def test_a_robot_does_what_the_last_one_who_called_it_wants() -> None:
    called = Called()
    called.go_on()
    called.says("robo", "robot")
    assert called.order == {"robot": "robo", "do": "stay"}
    called.says("bob", "come", {})
    assert called.order == {"robot": "robo", "do": "come", "whom": "bob"}
    called.says("ann", "mirror", {"robot": "robo"})
    # Ann stands at the origin and the robot at (6, 0): the mirror is across the middle.
    assert called.order == {"robot": "robo", "do": "mirror", "whom": "ann", "mirror": [3.0, 0.0, pytest.approx(pi / 2)]}
    called.says("bob", "stay", {"robot": "somebody else"})
    assert called.order["do"] == "mirror"
    called.says("bob", "stay", None)
    assert called.order["do"] == "stay"


def test_a_robot_takes_no_orders_from_itself_or_about_nobody() -> None:
    called = Called()
    called.go_on()
    called.says("robo", "robot")
    called.says("robo", "come", {})
    called.says("ann", "come", {"robot": "nobody"})
    assert called.order["do"] == "stay"
