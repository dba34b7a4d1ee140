"""Attitudes that are no more than the path: the identity, or headings computed from velocity."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from support.relocalised import relocalised

from synchronizar.arrays import Array
from synchronizar.data.track import Track
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.pose_stream import PoseStream
from synchronizar.preprocessing.relocalizations import attitude_follows, repair_relocalizations
from synchronizar.quaternions import yaw_quaternion, yaw_quaternions

MODEL = Parameters()
Way = Literal["identity", "from", "to", "about"]


def to_and_fro(way: Way, hz: float = 20.0) -> Track:
    """x = 1.5 sin(t): 1.5 m/s in the middle, back and forth, which is a cusp every pi s; the heading from the path."""
    t = np.arange(round(14.0 * hz)) / hz
    position = np.column_stack([1.5 * np.sin(t), 0.1 * t, 0.0 * t])
    return replace(Track(t, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))), quat_xyzw=headings(t, position, way))


def headings(t: Array, position: Array, way: Way) -> Array:
    if way == "identity":
        return np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    step = np.diff(position, axis=0)
    d = {
        "from": np.vstack([step, step[-1:]]),
        "to": np.vstack([step[:1], step]),
        "about": np.gradient(position, t, axis=0),
    }[way]
    return yaw_quaternions(np.arctan2(d[:, 1], d[:, 0]))


@pytest.mark.parametrize("way", ["from", "to", "about", "identity"])
@pytest.mark.parametrize("hz", [10.0, 20.0, 30.0])
def test_a_heading_that_flips_where_the_device_turns_back_is_no_jump(way: Way, hz: float) -> None:
    track = to_and_fro(way, hz)
    assert attitude_follows(track, MODEL) is True
    assert repair_relocalizations(track, MODEL).track is track


@pytest.mark.parametrize("way", ["from", "to", "about"])
def test_a_stream_mends_nothing_where_a_heading_flips(way: Way) -> None:
    track = to_and_fro(way)
    stream = PoseStream(MODEL)
    suspects = []
    for t, position, quat in zip(track.t.tolist(), track.position.tolist(), track.quat_xyzw.tolist(), strict=True):
        stream.add(t, position, quat)
        suspects.append(stream.suspect is not None)
    stream.settle()
    assert not stream.jumps
    np.testing.assert_allclose(stream.tail(-np.inf).position, track.position, atol=1e-12)
    assert not any(suspects[len(suspects) // 2 :])  # after the first flips it knows


def test_an_attitude_that_sways_as_in_a_hand_was_measured() -> None:
    track = to_and_fro("about")
    sway = yaw_quaternions(0.15 * np.sin(5.0 * track.t) + yaw_of(track))
    assert attitude_follows(replace(track, quat_xyzw=sway), MODEL) is False


def yaw_of(track: Track) -> Array:
    return np.asarray(2.0 * np.arctan2(track.quat_xyzw[:, 2], track.quat_xyzw[:, 3]))


@pytest.mark.parametrize("way", ["identity", "about"])
def test_where_attitudes_follow_from_the_path_velocities_tell_how_axes_turned(way: Way) -> None:
    """SLAM is off by 2 m and 0.5 rad from pose 40 on, amid a quick stretch of the way."""
    true = to_and_fro(way)
    slam = relocalised(
        replace(true, quat_xyzw=headings(true.t, true.position, "identity")), 125, (0.0, 2.0, 0.0), yaw_quaternion(0.5)
    )
    slam = replace(slam, quat_xyzw=headings(slam.t, slam.position, way))
    repaired = repair_relocalizations(slam, MODEL)
    assert [jump.pose for jump in repaired.jumps] == [125]
    assert repaired.jumps[0].turn == pytest.approx(0.5, abs=0.1)
    assert np.linalg.norm(repaired.track.position - true.position, axis=1).max() < 0.5
