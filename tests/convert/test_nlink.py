"""Frames of Nooploop modules, laid out here field by field as the maker's protocol has them."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from synchronizar.cli import main
from synchronizar.convert.asked import Asked
from synchronizar.convert.imported import Imported
from synchronizar.convert.importing import parts_of
from synchronizar.convert.nlink import Frames
from synchronizar.progress import unheard

NODE, ANCHOR, TAG = 0, 1, 2


def summed(body: bytes) -> bytes:
    return body + bytes([sum(body) % 256])


def int24(millimetres: int) -> bytes:
    return struct.pack("<i", millimetres)[:3]


def node_frame_2(t_ms: int, me: int, nodes: list[tuple[int, int, int, int, int]]) -> bytes:
    """Nodes (role, id, distance mm, fp and rx in -0.5 dBm)."""
    length = 119 + 13 * len(nodes) + 1
    body = struct.pack("<BBHBBI", 0x55, 0x04, length, NODE, me, t_ms)
    body += bytes(3) + 3 * int24(7000) + 3 * int24(-10) + bytes(9) + struct.pack("<6f", *range(6)) + bytes(12)
    body += struct.pack("<3h4f", 1, 2, 3, 1.0, 0.0, 0.0, 0.0) + bytes(4) + struct.pack("<I", 99) + bytes(10)
    body += struct.pack("<HB", 5000, len(nodes))
    for role, number, distance, fp, rx in nodes:
        body += bytes([role, number]) + int24(distance) + bytes([fp, rx]) + struct.pack("<I", t_ms) + bytes(2)
    assert len(body) == length - 1
    return summed(body)


def node_frame_3(t_ms: int, me: int, other: int, distance: int) -> bytes:
    body = struct.pack("<BBHBBIIIHB", 0x55, 0x05, 29, TAG, me, 12, t_ms, 0, 5000, 1)
    return summed(body + bytes([ANCHOR, other]) + int24(distance) + bytes([160, 150]))


def node_frame_5(t_ms: int, me: int, other: int, distance: int) -> bytes:
    body = struct.pack("<BBHBIIIIHB", 0x55, 0x08, 35, NODE, me, 12, t_ms, 0, 5000, 1)
    return summed(body + struct.pack("<BI", NODE, other) + int24(distance) + bytes([160, 150]))


def aoa_frame(t_ms: int, me: int, other: int, distance: int) -> bytes:
    body = struct.pack("<BBHBBIIIHB", 0x55, 0x07, 33, TAG, me, 12, t_ms, 0, 5000, 1)
    return summed(body + bytes([ANCHOR, other]) + int24(distance) + struct.pack("<hBB", -4500, 160, 150) + bytes(2))


def tag_frame(t_ms: int, me: int, distances: list[int]) -> bytes:
    body = bytes([0x55, 0x01, me, TAG]) + 6 * int24(5) + b"".join(map(int24, distances)) + bytes(24 + 12 + 6 + 16 + 4)
    return summed(body + struct.pack("<II", 12, t_ms) + bytes(1 + 3 + 2 + 5))


def anchor_frame(t_ms: int, tag: int, centimetres: list[int]) -> bytes:
    row = bytes([tag, TAG]) + 3 * int24(5) + struct.pack("<8H", *centimetres)
    body = bytes([0x55, 0x00]) + row + 29 * (b"\xff" + bytes(26)) + bytes(67)
    return body + struct.pack("<IIHIBB", 12, 0, 5000, t_ms, 0, ANCHOR) + b"\xee"


def read(tmp_path: Path, data: bytes, **asked: str) -> Imported:
    file = tmp_path / "tag.bin"
    file.write_bytes(data)
    parts, _ = parts_of(file, None)
    assert parts[0].format.name == "nooploop"
    imported: Imported = parts[0].format.reading().read(file, Asked(**asked), unheard)
    return imported


def test_a_node_frame_gives_each_range_with_its_powers_at_the_networks_time(tmp_path: Path) -> None:
    rows = read(tmp_path, node_frame_2(123_456, 3, [(NODE, 7, 2250, 161, 158), (NODE, 8, 0, 0, 0)])).ranges
    assert (list(rows.t), rows.a, rows.b) == ([pytest.approx(123.456)], ["3"], ["7"])
    assert list(rows.distance) == [pytest.approx(2.25)]
    assert (list(rows.fp_power), list(rows.rx_power)) == ([-80.5], [-79.0])


@pytest.mark.parametrize(
    ("frame", "b"),
    [(node_frame_3(5500, 2, 1, 12_345), "anchor1"), (aoa_frame(5500, 2, 1, 12_345), "anchor1"),
     (node_frame_5(5500, 2, 70_000, 12_345), "70000")],
)  # fmt: skip
def test_every_frame_of_nodes_has_its_own_layout(tmp_path: Path, frame: bytes, b: str) -> None:
    rows = read(tmp_path, frame).ranges
    assert (list(rows.t), rows.a, rows.b, list(rows.distance)) == ([5.5], ["2"], [b], [pytest.approx(12.345)])
    assert list(rows.rx_power) == [-75.0]


@pytest.mark.parametrize(
    "frame", [tag_frame(5500, 0, [1000, 0, 2500] + 5 * [0]), anchor_frame(5500, 0, [100, 0, 250] + 5 * [0])]
)
def test_a_tags_own_number_is_no_anchors(tmp_path: Path, frame: bytes) -> None:
    rows = read(tmp_path, frame).ranges
    assert (list(rows.t), rows.a, rows.b) == ([5.5] * 2, ["0", "0"], ["anchor0", "anchor2"])
    assert list(rows.distance) == pytest.approx([1.0, 2.5])
    assert set(read(tmp_path, frame, user="alice").ranges.a) == {"alice"}


def test_what_is_broken_is_skipped_and_counted_and_the_rest_is_read(tmp_path: Path) -> None:
    frames = [node_frame_2(1000 * k, 3, [(NODE, 7, 2000 + k, 160, 160)]) for k in range(5)]
    wrong = bytearray(frames[1])
    wrong[122] ^= 0x10
    other = summed(struct.pack("<BBHBB", 0x55, 0x02, 12, NODE, 1) + b"\x55\x04\x00\x00\x09")  # data that is sent on
    data = b"boot\x00\xff" + frames[0] + bytes(wrong) + other + frames[2][:60] + frames[3] + frames[4][:-5]
    imported = read(tmp_path, data)
    assert list(imported.ranges.distance) == pytest.approx([2.0, 2.003])
    told = 6 + len(wrong) + 60 + len(frames[4]) - 5
    assert f"{told} of {len(data)} bytes of tag.bin are of broken frames, and skipped" in imported.notes


def test_a_stream_without_a_range_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for data, fault in (
        (node_frame_2(0, 3, []), "has 1 frames, and no range"),
        (b"\x55\x04\x00" * 9, "no whole frame"),
    ):
        (tmp_path / "tag.bin").write_bytes(data)
        assert main(["convert", str(tmp_path / "tag.bin"), str(tmp_path / "out"), "--from", "nooploop"]) == 2
        err = capsys.readouterr().err
        assert fault in err
        assert err.count("\n") == 1


def test_headers_without_end_take_no_longer_than_other_bytes() -> None:
    # Each of them claims a frame of 65,535 bytes: added up one by one they are 1.6e10 of them.
    frames = Frames(b"\x55\x02\xff\xff" * 250_000)
    assert list(frames.ranges()) == []
    assert frames.skipped == 1_000_000
