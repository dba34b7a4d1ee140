from __future__ import annotations

import re
import shutil
import struct
import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from hashlib import blake2s

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.datagrams import some_ranges
from support.paths import REPOSITORY

from synchronizar.io.datagrams import (
    RANGE,
    OrderDatagram,
    RangesDatagram,
    RoomKeys,
    Sender,
    Window,
    WireError,
    decode_order,
    decode_ranges,
    encode_order,
    encode_ranges,
    reporter_key,
)

FIRMWARE = REPOSITORY / "firmware"
KEY = bytes(range(32))
VECTORS = re.findall(r'^\{"(.*)", "(.*)", "(.*)"\},$', (FIRMWARE / "tests/vectors/wire_vectors.txt").read_text(), re.M)

REPORTER_KEYS = re.findall(
    r'^\{"(.*)", (.*), (.*), "(.*)"\},$', (FIRMWARE / "tests/vectors/reporter_keys.txt").read_text(), re.M
)

Decoded = RangesDatagram | OrderDatagram


def everybodys(sender: Sender) -> bytes:
    """As the stored datagrams have it: whoever speaks has KEY."""
    if sender.version != 2:
        raise WireError("version")
    return KEY


def decode(datagram: bytes) -> Decoded:
    try:
        return decode_ranges(datagram, everybodys)
    except WireError:
        return decode_order(datagram, KEY)


def encode(said: Decoded) -> bytes:
    return encode_ranges(said, KEY) if isinstance(said, RangesDatagram) else encode_order(said, KEY)


def as_text(datagram: bytes) -> str:
    """As in vectors/wire_vectors.txt."""
    try:
        said = decode(datagram)
    except WireError:
        return "refused"
    if isinstance(said, OrderDatagram):
        return f"order {said.session} {said.module} {said.sequence} {said.sleep_s}"
    begin = f"ranges {said.session} {said.reporter} {said.sequence} {said.time_ns} {said.epoch} {said.dropped}"
    return begin + "".join(" | " + " ".join(map(str, row[:-1])) for row in said.ranges.tolist())


def sealed(said: bytes) -> bytes:
    return said + blake2s(said, digest_size=16, key=KEY).digest()


def some_datagram(n: int = 2) -> RangesDatagram:
    return RangesDatagram(5, 7, 11, 13, 17, 0, some_ranges(np.arange(100, 100 + n), 1000))


def test_there_are_stored_datagrams() -> None:
    assert len(VECTORS) == 55


@pytest.mark.parametrize(("datagram", "said"), [pytest.param(*v[1:], id=v[0]) for v in VECTORS])
def test_stored_datagrams_are_read_as_they_were_meant(datagram: str, said: str) -> None:
    assert as_text(bytes.fromhex(datagram)) == said


@pytest.mark.parametrize("datagram", [pytest.param(v[1], id=v[0]) for v in VECTORS if v[2] != "refused"])
def test_what_is_read_is_written_as_the_same_bytes(datagram: str) -> None:
    assert encode(decode(bytes.fromhex(datagram))) == bytes.fromhex(datagram)


@pytest.mark.parametrize(
    ("expected", "change"),
    [
        ("magic", {0: 0x54}),
        ("version", {4: 3}),
        ("kind", {5: 2}),
        ("size", {6: 3}),
        ("reserved", {7: 1}),
        ("reserved", {15: 1}),
        ("address", {12: 0xFE, 13: 0xFF}),
        ("time", {31: 0x41}),
        ("itself", {40: 7}),
        ("address", {40: 0xFE, 41: 0xFF}),
        ("source", {42: 5}),
        ("status", {43: 3}),
        ("distance", {47: 1}),
        ("offset", {51: 1}),
        ("sigma", {56: 0, 57: 0}),
        ("sight", {62: 2}),
        ("reserved", {63: 1}),
    ],
)
def test_a_refusal_says_why(expected: str, change: dict[int, int]) -> None:
    said = bytearray(encode_ranges(some_datagram(), KEY)[:-16])
    for at, value in change.items():
        said[at] = value
    with pytest.raises(WireError, match=f"^{expected}$"):
        decode_ranges(sealed(bytes(said)), everybodys)


def test_the_tag_is_looked_at_before_all_that_finds_no_key() -> None:
    said = encode_ranges(some_datagram(), bytes(32))
    for at in range(5, len(said) - 16):
        with pytest.raises(WireError, match=r"^tag$"):
            decode_ranges(said[:at] + b"\xff" + said[at + 1 :], everybodys)
    with pytest.raises(WireError, match=r"^tag$"):
        decode_order(bytes(44), KEY)


@pytest.mark.parametrize(
    "change",
    [
        {"session": -1},
        {"session": 2**32},
        {"reporter": 0xFFFE},
        {"reporter": -1},
        {"reporter": 101},
        {"sequence": 2**64},
        {"epoch": 2**32},
        {"time_ns": 2**62 + 1},
        {"time_ns": -1},
        {"dropped": -1},
        {"ranges": some_ranges(np.arange(33), 0)},
        {"ranges": some_ranges([1], 10_000_001)},
        {"ranges": some_ranges([1], -(2**31))},
        {"ranges": some_ranges([1], 0, sight=7)},
        {"ranges": some_ranges([1], 0, reserved=1)},
        {"ranges": np.zeros(1)},
    ],
)
def test_what_no_reader_takes_is_not_written(change: dict[str, object]) -> None:
    with pytest.raises(WireError):
        encode_ranges(replace(some_datagram(), **change), KEY)  # type: ignore[arg-type]


@pytest.mark.parametrize("order", [(2**32, 7, 0, 0), (0, 0xFFFE, 0, 0), (0, 7, -1, 0), (0, 7, 0, 2**32)])
def test_an_order_that_no_module_takes_is_not_written(order: tuple[int, int, int, int]) -> None:
    with pytest.raises(WireError):
        encode_order(OrderDatagram(*order), KEY)


def test_a_key_of_another_size_is_a_fault_of_the_program() -> None:
    with pytest.raises(ValueError, match="32 bytes"):
        encode_ranges(some_datagram(), KEY[:16])


def test_what_is_not_known_is_written_as_unknown() -> None:
    said = some_ranges([3, 4], [10, 20], sigma_mm=[5, 6])
    assert said.dtype == RANGE
    assert said.tolist() == [
        (3, 0, 0, 10, 0, -(2**31), 5, -(2**15), -(2**15), 255, 0),
        (4, 0, 0, 20, 0, -(2**31), 6, -(2**15), -(2**15), 255, 0),
    ]


def u(bits: int) -> st.SearchStrategy[int]:
    return st.integers(0, 2**bits - 1)


@st.composite
def datagrams(draw: st.DrawFn) -> Decoded:
    address = st.integers(0, 0xFFFD)
    if draw(st.booleans()):
        return OrderDatagram(draw(u(32)), draw(address), draw(u(64)), draw(u(32)))
    reporter = draw(address)
    rows = st.tuples(
        address.filter(lambda peer: peer != reporter),
        st.integers(0, 4),
        st.integers(0, 2),
        st.integers(-10_000_000, 10_000_000),
        st.integers(-10_000_000, 10_000_000),
        st.integers(-(2**31), 2**31 - 1),
        st.integers(1, 2**16 - 1),
        st.integers(-(2**15), 2**15 - 1),
        st.integers(-(2**15), 2**15 - 1),
        st.sampled_from([0, 1, 255]),
        st.just(0),
    )
    ranges = np.array(draw(st.lists(rows, min_size=1, max_size=32)), dtype=RANGE)
    return RangesDatagram(
        draw(u(32)), reporter, draw(u(64)), draw(u(32)), draw(st.integers(0, 2**62)), draw(u(32)), ranges
    )


@given(datagrams())
def test_what_is_written_is_read_the_same(said: Decoded) -> None:
    read = decode(encode(said))
    assert type(read) is type(said)
    for name, value in vars(said).items():
        np.testing.assert_array_equal(getattr(read, name), value)


@given(datagrams(), st.data())
def test_no_change_of_a_byte_goes_unnoticed(said: Decoded, data: st.DataObject) -> None:
    datagram = bytearray(encode(said))
    datagram[data.draw(st.integers(0, len(datagram) - 1))] ^= data.draw(st.integers(1, 255))
    with pytest.raises(WireError, match=r"^(tag|size)$"):
        decode(bytes(datagram))  # what finds no key as ranges is read as an order


@given(st.binary(max_size=900), st.booleans())
def test_any_bytes_are_read_or_refused(said: bytes, with_tag: bool) -> None:
    datagram = sealed(said) if with_tag else said
    with suppress(WireError):
        decode_ranges(datagram, everybodys)
    with suppress(WireError):
        decode_order(datagram, KEY)
    with suppress(WireError):
        decode_ranges(datagram, RoomKeys(5, KEY))


# ---- keys ----


@pytest.mark.parametrize(("room", "session", "address", "own"), REPORTER_KEYS)
def test_each_reporter_has_a_key_of_its_own(room: str, session: str, address: str, own: str) -> None:
    key = reporter_key(bytes.fromhex(room), int(session), int(address))
    assert key.hex() == own
    assert RoomKeys(int(session), bytes.fromhex(room)).of(int(address)) == key


def test_a_room_finds_the_key_of_whoever_speaks() -> None:
    keys = RoomKeys(5, KEY)
    assert decode_ranges(encode_ranges(some_datagram(), keys.of(7)), keys).reporter == 7
    for key in (KEY, keys.of(8), reporter_key(KEY, 6, 7), reporter_key(bytes(32), 5, 7)):
        with pytest.raises(WireError, match=r"^tag$"):
            decode_ranges(encode_ranges(some_datagram(), key), keys)


@pytest.mark.parametrize(
    ("reason", "change"),
    [("session", {"session": 6}), ("address", {"reporter": 0xFFFE}), ("version", {"version": 1})],
)
def test_who_can_have_no_key_is_refused_before_the_tag(reason: str, change: dict[str, int]) -> None:
    said = {"version": 2, "session": 5, "reporter": 7} | change
    head = struct.pack("<4sBBBBIHHQ", b"SYNC", said["version"], 1, 0, 0, said["session"], said["reporter"], 0, 1)
    with pytest.raises(WireError, match=f"^{reason}$"):
        decode_ranges(sealed(head + bytes(16)), RoomKeys(5, KEY))


def test_the_version_before_is_read_where_that_is_allowed() -> None:
    """Its tag is of the room's key, and of no other; what is written is never of that version."""
    (before,) = (bytes.fromhex(v[1]) for v in VECTORS if v[0] == "the version before")
    keys = RoomKeys(305419896, KEY, allow_version_1=True)
    assert decode_ranges(before, keys).ranges["distance_mm"].tolist() == [2345]
    with pytest.raises(WireError, match=r"^tag$"):
        decode_ranges(before, RoomKeys(305419896, bytes(32), allow_version_1=True))
    with pytest.raises(WireError, match=r"^version$"):
        decode_ranges(before, RoomKeys(305419896, KEY))
    assert encode_ranges(decode_ranges(before, keys), KEY)[4] == 2


def test_a_room_s_key_has_its_size() -> None:
    with pytest.raises(ValueError, match="32 bytes"):
        RoomKeys(5, KEY[:16])


@pytest.fixture(scope="module")
def read_by_c(tmp_path_factory: pytest.TempPathFactory) -> Callable[[list[bytes]], list[str]]:
    """What the C codec makes of datagrams."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    tool = tmp_path_factory.mktemp("wire") / "wire_tool"
    sources = [FIRMWARE / "tests/wire_tool.c", FIRMWARE / "core/wire.c", FIRMWARE / "core/blake2s.c"]
    subprocess.run([compiler, "-std=c11", "-O1", f"-I{FIRMWARE / 'core'}", *sources, "-o", tool], check=True)

    def read(datagrams: list[bytes]) -> list[str]:
        lines = "".join(datagram.hex() + "\n" for datagram in datagrams)
        return subprocess.run([tool], input=lines, capture_output=True, text=True, check=True).stdout.splitlines()

    return read


def mutations(random: np.random.Generator) -> Iterator[bytes]:
    """Stored datagrams in which something was changed; most have a tag that fits."""
    stored = [bytes.fromhex(v[1])[:-16] for v in VECTORS for _ in range(20 if v[2] == "refused" else 250)]
    boundaries = [struct.pack("<i", v) for v in (0, 1, -1, 10**7, 10**7 + 1, -(10**7), -(10**7) - 1, 2**31 - 1)]
    for said in stored:
        changed = bytearray(said)
        for _ in range(random.integers(3)):
            at = int(random.integers(len(changed) + 1))
            match random.integers(5):
                case 0:
                    changed[at : at + 1] = random.bytes(1)
                case 1:
                    changed[at : at + 4] = boundaries[random.integers(len(boundaries))]
                case 2:
                    del changed[at:]
                case 3:
                    changed[at:] = random.bytes(24)
                case 4 if len(changed) > 6:
                    changed[6] = random.integers(34)
        datagram = sealed(bytes(changed))
        yield datagram if random.random() < 0.9 else datagram[:-1] + random.bytes(1)


def test_the_c_codec_reads_the_same(read_by_c: Callable[[list[bytes]], list[str]]) -> None:
    datagrams = list(mutations(np.random.default_rng(6)))
    said = [as_text(datagram) for datagram in datagrams]
    assert said == read_by_c(datagrams)
    accepted = sum(text != "refused" for text in said)
    assert 800 < accepted < len(said) - 800


# ---- the window ----


def test_the_window_reaches_63_behind_the_newest() -> None:
    window = Window()
    assert window.take(1000)
    assert not window.take(1000)
    assert not window.take(936)
    assert window.take(937)
    assert not window.take(937)
    assert window.take(1063)
    assert not window.take(1000)
    assert window.take(1001)


def test_sequences_go_from_zero_to_the_last() -> None:
    window = Window()
    assert window.take(0)
    assert not window.take(0)
    assert window.take(2**64 - 1)
    assert not window.take(2**64 - 1)
    assert not window.take(0)


@given(st.lists(st.integers(0, 200), max_size=200), st.sampled_from([0, 2**32 - 100, 2**64 - 201]))
def test_the_window_agrees_with_a_list_of_all(sequences: list[int], begin: int) -> None:
    window = Window()
    taken: set[int] = set()
    for sequence in sequences:
        fresh = sequence not in taken and sequence > max(taken, default=-1) - 64
        assert window.take(begin + sequence) == fresh
        taken |= {sequence} if fresh else set()
