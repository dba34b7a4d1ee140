"""First-person views of programs, both ways: a robot's camera, drawn or real, and what others send it."""

from __future__ import annotations

import asyncio
import base64
import io
from math import pi
from typing import Any

import numpy as np
import pytest
from apps.test_robot import Called
from PIL import Image

from synchronizar.apps.bodies.body import EYES_TOPIC, RosbridgeBody, SimulatedBody
from synchronizar.apps.bodies.camera import COLOURS, HALF, HEIGHT, WIDTH, picture, view
from synchronizar.apps.bodies.drive import Drive, Ground
from synchronizar.apps.looks import LOOK, looks_of
from synchronizar.apps.robot.pilot import Pilot
from synchronizar.apps.stills import ASKS_EVERY_S, EVERY_S, LARGEST, Stills, View, jpeg_of, shrunk
from synchronizar.live import messages as m

VIEW = View(b"\xff\xd8 picture", 0.5, 1.25)


def look(who: str, whom: str, state: str) -> dict[str, m.Object]:
    data = {"who": who, "whom": whom, "state": state, "since": 0.0}
    o = m.Object("look 0", LOOK, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), m.APP, m.APP, None, 0.0, data)
    return {o.id: o}


def test_a_program_lets_look_who_asks_and_shows_nothing_to_others() -> None:
    stills = Stills("robo", lambda: VIEW)
    assert stills.words(0.0, look("ann", "ben", "on")) == []
    assert stills.words(0.0, look("ann", "robo", "asked")) == [m.Say("allow", {"who": "ann"}, m.APP)]
    (said,) = stills.words(1.0, look("ann", "robo", "on"))
    assert (said.topic, said.to) == ("eye", "ann")
    assert said.data == {"jpeg": base64.b64encode(VIEW.jpeg).decode(), "half": 0.5, "aspect": 1.25}
    assert stills.words(1.0 + 0.5 * EVERY_S, look("ann", "robo", "on")) == []
    # The room's page has no address: all hear what it may see.
    assert [said.to for said in stills.words(3.0, look("", "robo", "on"))] == [None]


def test_a_program_asks_for_somebodys_eyes_until_it_has_them_and_keeps_what_comes() -> None:
    stills = Stills("robo", lambda: None, through="ann")
    assert stills.words(0.0, {}) == [m.Say("ask", {"whom": "ann"}, m.APP)]
    assert stills.words(0.5 * ASKS_EVERY_S, {}) == []
    assert len(stills.words(1.1 * ASKS_EVERY_S, {})) == 1
    assert stills.words(9.0 * ASKS_EVERY_S, look("robo", "ann", "on")) == []
    data = {"jpeg": base64.b64encode(VIEW.jpeg).decode(), "half": 0.5, "aspect": 1.25}
    assert stills.hear(m.Said("eye", data, "ann")) == "ann"
    assert stills.seen == {"ann": VIEW}
    for odd in (None, {}, data | {"jpeg": "?"}, data | {"jpeg": 3}, data | {"half": "x"}):
        assert stills.hear(m.Said("eye", odd, "ben")) is None
    assert stills.hear(m.Said("other", data, "ben")) is None
    assert stills.seen == {"ann": VIEW}


def test_a_picture_fits_into_a_word_whatever_it_shows() -> None:
    noise = np.random.default_rng(1).integers(0, 255, (480, 640, 3)).astype(np.uint8)
    out = io.BytesIO()
    Image.fromarray(noise).save(out, "PNG")
    small, aspect = shrunk(out.getvalue(), 128)
    assert aspect == pytest.approx(4.0 / 3.0)
    for jpeg in (small, jpeg_of(picture(Ground(0.0, 0.0, 0.0), [(2.0, 0.0)]))):
        assert len(jpeg) <= LARGEST
        Image.open(io.BytesIO(jpeg)).load()
    with pytest.raises(OSError):
        shrunk(b"no picture")


@pytest.mark.parametrize("heading", [0.0, 0.5 * pi, -2.0])
def test_a_drawn_camera_sees_somebody_where_that_one_is(heading: float) -> None:
    """3 m ahead and 0.6 m to the left, of a robot that stands somewhere and looks somewhere."""
    c, s = np.cos(heading), np.sin(heading)
    person = (5.0 + 3.0 * c - 0.6 * s, -2.0 + 3.0 * s + 0.6 * c)
    shown = picture(Ground(5.0, -2.0, heading), [person]).astype(float)
    away = np.abs(shown - picture(Ground(5.0, -2.0, heading), []).astype(float)).sum(axis=2) > 0
    rows, columns = np.nonzero(away)
    focal = 0.5 * HEIGHT / HALF
    assert columns.mean() == pytest.approx(0.5 * WIDTH - focal * 0.6 / 3.0, abs=1.5)
    # 1.76 m high at a distance of 3 m, less the shoulders of the eye's own height.
    assert (rows.max() - rows.min()) == pytest.approx(focal * 1.76 / 3.0, rel=0.1)
    hue = shown[away].mean(axis=0)
    assert np.argmin(np.abs(COLOURS - hue).sum(axis=1)) == 0


def test_who_is_nearer_hides_who_is_behind_and_who_is_at_the_back_is_not_seen() -> None:
    near = picture(Ground(0.0, 0.0, 0.0), [(2.0, 0.0)])
    np.testing.assert_array_equal(picture(Ground(0.0, 0.0, 0.0), [(2.0, 0.0), (8.0, 0.0)])[60:], near[60:])
    np.testing.assert_array_equal(picture(Ground(0.0, 0.0, 0.0), [(-2.0, 0.3)]), picture(Ground(0.0, 0.0, 0.0), []))


def test_a_simulated_robot_sees_nothing_before_it_knows_where_it_is() -> None:
    body = SimulatedBody(Drive(Ground(0.0, 0.0, 0.0), 0), lambda: 0.0)
    assert body.see(None, {}) is None
    assert body.see(Ground(0.0, 0.0, 0.0), {"ann": (2.0, 0.0)}) == view(Ground(0.0, 0.0, 0.0), {"ann": (2.0, 0.0)})


def test_a_robot_sees_those_alone_of_whom_it_has_just_heard() -> None:
    pilot = Pilot()
    pilot.own(10.0, "registered", 0.1)
    pilot.person(8.0, "ben", Ground(1.0, 0.0, 0.0), 0.1)
    pilot.person(9.9, "ann", Ground(2.0, 0.0, 0.0), 0.1)
    assert pilot.places == {"ann": (2.0, 0.0)}


def test_people_see_what_the_robot_sees_and_the_robot_what_they_do_once_they_say_so() -> None:
    called = Called()
    called.go_on()
    robo = Stills("robo", lambda: VIEW, through="bob")

    def robot_acts(t: float) -> list[m.Say]:
        words = robo.words(t, called.house.room.objects.objects)
        for word in words:
            called.house.room.hear(called.clients["robo"], word)
        called.go_on()
        return words

    called.says("ann", "ask", {"whom": "robo"})
    robot_acts(0.0)
    objects = called.house.room.objects.objects
    assert sorted((o.data["who"], o.data["state"]) for o in looks_of(objects)) == [("ann", "on"), ("robo", "asked")]
    called.says("bob", "allow", {"who": "robo"})
    assert [(w.topic, w.to) for w in robot_acts(1.0)] == [("eye", "ann")]
    eyes = [w for w in called.house.said_to(called.clients["ann"]) if isinstance(w, m.Said) and w.topic == "eye"]
    assert [w.by for w in eyes] == ["robo"]
    assert not [w for w in called.house.said_to(called.clients["bob"]) if isinstance(w, m.Said) and w.topic == "eye"]


def test_a_robot_with_ros_gives_its_cameras_pictures_and_gets_what_others_see() -> None:
    from apps.test_robot import _mock

    out = io.BytesIO()
    Image.new("RGB", (640, 360), (10, 200, 30)).save(out, "PNG")
    heard: list[Any] = []

    async def go() -> None:
        runner, address = await _mock(heard)
        body = await RosbridgeBody.connect(address, camera_topic="/front/compressed", clock=lambda: 7.0)
        assert body.see(None, {}) is None
        body.take("/front/compressed", {"format": "png", "data": base64.b64encode(out.getvalue()).decode()})
        seen = body.see(None, {})
        assert seen is not None
        assert seen.aspect == pytest.approx(16.0 / 9.0)
        assert Image.open(io.BytesIO(seen.jpeg)).getpixel((5, 5)) == pytest.approx((10, 200, 30), abs=6)
        await body.show("ann", VIEW)
        await body.close()
        async with asyncio.timeout(20.0):
            while not any(word.get("topic") == EYES_TOPIC and word["op"] == "publish" for word in heard):
                await asyncio.sleep(0.01)
        await runner.cleanup()

    asyncio.run(go())
    (subscribed,) = [word for word in heard if word.get("topic") == "/front/compressed"]
    assert subscribed["type"] == "sensor_msgs/CompressedImage"
    (told,) = [word["msg"] for word in heard if word["op"] == "publish" and word["topic"] == EYES_TOPIC]
    assert (told["header"]["frame_id"], base64.b64decode(told["data"])) == ("ann", VIEW.jpeg)
