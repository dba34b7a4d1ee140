from __future__ import annotations

import json
import math
from contextlib import suppress

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synchronizar.live import messages as m
from synchronizar.live.messages import MessageError
from synchronizar.live.pose_wire import (
    DOWN,
    UP,
    PoseDown,
    PosesDown,
    PoseUp,
    decode_poses_down,
    decode_poses_up,
    encode_poses_down,
    encode_poses_up,
)

COORDINATE = st.floats(-1e6, 1e6)
STAMP = st.floats(0.0, 1e11)
QUATERNION = st.tuples(*[st.floats(-1.0, 1.0, width=32)] * 4).filter(lambda q: sum(x * x for x in q) > 1e-3)
POSE = st.builds(
    PoseUp,
    st.integers(0, 65535),
    st.integers(0, 255),
    st.integers(0, 2**32 - 1),
    STAMP,
    st.tuples(COORDINATE, COORDINATE, COORDINATE),
    QUATERNION,
)


@given(st.lists(POSE, min_size=1, max_size=5))
def test_poses_of_a_device_come_back_as_they_were(poses: list[PoseUp]) -> None:
    assert decode_poses_up(encode_poses_up(poses)) == poses


@given(
    st.lists(st.tuples(st.integers(0, 65535), st.tuples(COORDINATE, COORDINATE, COORDINATE), QUATERNION), max_size=5)
)
def test_everybodys_poses_come_back_as_they_were(devices: list[tuple[int, m.Vector, m.Quaternion]]) -> None:
    poses = [PoseDown(device, "registered", 3, 0.25, xyz, quat) for device, xyz, quat in devices]
    message = PosesDown(7, 12.5, poses)
    assert decode_poses_down(encode_poses_down(message)) == message


def test_the_bytes_of_a_pose_are_those_of_the_table() -> None:
    data = encode_poses_up([PoseUp(2, 1, 3, 4.0, (5.0, 6.0, 7.0), (0.0, 0.0, 0.0, 1.0))])
    by_hand = bytes.fromhex("01 01 0200 03000000 0000000000001040 0000000000001440 0000000000001840 0000000000001c40")
    assert data == by_hand + bytes.fromhex("00000000 00000000 00000000 0000803f")
    assert (UP.itemsize, DOWN.itemsize) == (56, 48)


@given(st.binary(max_size=200))
def test_any_bytes_are_poses_or_are_refused(data: bytes) -> None:
    for decode in (decode_poses_up, decode_poses_down):
        with suppress(MessageError):
            assert decode(data) is not None


@pytest.mark.parametrize(
    ("position", "quat", "t"),
    [
        ((math.nan, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 1.0),
        ((0.0, math.inf, 0.0), (0.0, 0.0, 0.0, 1.0), 1.0),
        ((0.0, 0.0, 1e30), (0.0, 0.0, 0.0, 1.0), 1.0),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), 1.0),
        ((0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0), 1.0),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), math.nan),
    ],
)
def test_a_pose_that_no_device_can_mean_is_refused(position: m.Vector, quat: m.Quaternion, t: float) -> None:
    with pytest.raises(MessageError, match=r"not finite|too large|zero"):
        decode_poses_up(encode_poses_up([PoseUp(0, 0, 0, t, position, quat)]))


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("{}", "message"),
        ("[]", "message"),
        ("nonsense", "malformed"),
        ('{"type":"ping","t":NaN}', "malformed"),
        ('{"type":"ping","t":1e999}', "message"),
        ('{"type":"ping","t":"1"}', "message"),
        ('{"type":"ping","t":1,"more":2}', "message"),
        ('{"type":"nobody"}', "message"),
        ('{"type":"welcome"}', "message"),
        ('{"type":"say","topic":"x","data":' + "[" * 5000, "malformed"),
        (" " * (m.LARGEST_MESSAGE + 1), "size"),
    ],
)
def test_words_that_are_no_message_are_refused_with_a_reason(words: str, reason: str) -> None:
    with pytest.raises(MessageError) as refused:
        m.decode_from_client(words)
    assert refused.value.reason == reason
    assert "\n" not in str(refused.value)


def test_what_a_client_says_is_plain_json() -> None:
    ranges = m.Ranges([m.MeasuredRange(1.5, "alice", "bob", 4.25, sigma=0.1)])
    words = json.loads(m.encode(ranges))
    assert words == {
        "type": "ranges",
        "ranges": [{"t": 1.5, "a": "alice", "b": "bob", "distance": 4.25, "sigma": 0.1}],
    }
    assert m.decode_from_client(json.dumps(words)) == ranges


def test_what_the_room_says_is_understood_by_a_client() -> None:
    frame = m.UserFrame(
        *("registered", "why", 0, [[1.0] * 4] * 4, 1.0, 2.0, 3.0, 0.5, 1.0, None, 0.1, 0.0, 1.0, None)  # type: ignore[arg-type]
    )
    frames = m.Frames(3, 12.0, "alice", {"bob": frame})
    assert m.decode_from_room(m.encode(frames)) == frames
    assert json.loads(m.encode(frames))["users"]["bob"]["covariance"] is None


def test_every_message_and_every_field_is_described() -> None:
    """The protocol's page is made from these."""
    for kind in (*m.FromClient.__args__, *m.FromRoom.__args__):
        assert kind.__doc__
        assert "Struct" not in kind.__doc__.split("\n")[0]
        assert isinstance(kind, type)
        assert issubclass(kind, msgspec.Struct)
