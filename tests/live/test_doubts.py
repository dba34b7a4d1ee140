"""Whose place is doubted, since it was corrected by more than what had been told of it allows."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from support.house import user_frame

from synchronizar.geometry import YawFrame
from synchronizar.live import messages as m
from synchronizar.live.doubts import Doubts
from synchronizar.live.member import Device

SIGMA = 0.03
COVARIANCE = (SIGMA**2 * np.diag([1.0, 1.0, 1.0, 0.01])).tolist()


def device(up: str = "z", position: m.Vector = (0.0, 0.0, 0.0)) -> Device:
    own = Device(m.UserSettings("ann", up=up), 0, "")  # type: ignore[arg-type]
    own.pose = 0.0, position, (0.0, 0.0, 0.0, 1.0)
    return own


def told(place: YawFrame, **other: Any) -> m.UserFrame:
    return msgspec.structs.replace(user_frame(place), covariance=COVARIANCE, **other)


def test_a_correction_beyond_what_was_told_is_doubted_once_and_one_within_it_is_not() -> None:
    doubts, ann = Doubts(), device()
    places = [0.0, 2.0 * SIGMA, 0.4, 0.4, 0.4 + 2.0 * SIGMA, 0.1]
    doubted = [doubts.look(float(t), ann, told(YawFrame(x=x))) for t, x in enumerate(places)]
    assert doubted == [False, False, True, False, False, True]


@pytest.mark.parametrize(("up", "position"), [("z", (20.0, 0.0, 1.5)), ("y", (0.0, 1.5, -20.0))])
def test_what_counts_is_how_things_move_where_the_device_is(up: str, position: m.Vector) -> None:
    # Turned about a place that is 20 m ahead of its origin: nothing moves there, and the origin by 0.4 m.
    turned = YawFrame(x=20.0 * (1.0 - np.cos(0.02)), y=-20.0 * np.sin(0.02), yaw=0.02, up_b=up)  # type: ignore[arg-type]
    known = (np.diag([4.0, 4.0, 0.03**2, 0.1**2])).tolist()
    known[1][3] = known[3][1] = -20.0 * 0.1**2
    known[1][1] = 400.0 * 0.1**2 + 0.03**2
    known[0][0] = 0.03**2
    doubts, ann = Doubts(), device(up, position)
    first, then = (msgspec.structs.replace(told(frame), covariance=known) for frame in (YawFrame(up_b=up), turned))  # type: ignore[arg-type]
    assert not doubts.look(0.0, ann, first)
    assert not doubts.look(1.0, ann, then)
    moved = msgspec.structs.replace(first, y=0.4)
    assert doubts.look(2.0, ann, moved)


def test_who_begins_anew_contradicts_nothing() -> None:
    doubts, ann = Doubts(), device()
    far = YawFrame(x=3.0)
    assert not doubts.look(0.0, ann, told(YawFrame()))
    assert not doubts.look(1.0, ann, told(far, frame=1)), "another frame of its SLAM"
    assert not doubts.look(2.0, ann, told(far, frame=1, state="ambiguous"))
    assert not doubts.look(3.0, ann, told(YawFrame(), frame=1)), "it was looked for anew"
    doubts.keep(())
    assert not doubts.look(4.0, ann, told(far, frame=1)), "it had left"


def test_without_a_covariance_nothing_was_promised() -> None:
    doubts, ann = Doubts(), device()
    assert not doubts.look(0.0, ann, user_frame(YawFrame()))
    assert not doubts.look(1.0, ann, user_frame(YawFrame(x=3.0)))
