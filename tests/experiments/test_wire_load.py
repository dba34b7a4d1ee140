from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from experiments.live import wire_load
from experiments.live.air import place
from experiments.live.wire_load import Load, datagrams
from synchronizar.io.datagrams import MAX_RANGES, RoomKeys, decode_ranges

KEYS = RoomKeys(4, bytes(range(32)))
OWN = {reporter: KEYS.of(reporter) for reporter in range(80)}


def test_each_pair_ranges_as_often_as_is_said_and_is_told_once() -> None:
    load = Load(reporters=32, neighbours=10, hz=10.0)
    told = [decode_ranges(one.payload, KEYS) for one in datagrams(load, 4, OWN, 0.0, 2.0)]
    pairs = [tuple(sorted((one.reporter, int(peer)))) for one in told for peer in one.ranges["peer"]]
    assert len(set(pairs)) == 32 * 10 // 2
    assert {pairs.count(pair) for pair in set(pairs)} == {20}


@pytest.mark.parametrize("reporters", [2, 3, 4, 7, 8])
def test_in_a_small_room_everybody_ranges_with_everybody(reporters: int) -> None:
    load = Load(reporters=reporters, neighbours=20, hz=1.0)
    told = [decode_ranges(one.payload, KEYS) for one in datagrams(load, 4, OWN, 0.0, 1.0)]
    pairs = [tuple(sorted((one.reporter, int(peer)))) for one in told for peer in one.ranges["peer"]]
    assert len(pairs) == len(set(pairs)) == reporters * (reporters - 1) // 2


def test_distances_are_those_of_the_truth_at_the_moment_they_were_measured() -> None:
    load = Load(reporters=5, neighbours=4, hz=5.0, sigma=0.05, seed=3)
    off = []
    for one in datagrams(load, 4, OWN, 100.0, 120.0):
        said = decode_ranges(one.payload, KEYS)
        for peer, mm, t in zip(said.ranges["peer"].tolist(), said.ranges["distance_mm"], one.measured, strict=True):
            off.append(1e-3 * mm - float(np.linalg.norm(place(3, said.reporter, t) - place(3, peer, t))))
        assert one.t - one.measured.max() >= 0.0015
    assert abs(np.mean(off)) < 0.01
    assert np.std(off) == pytest.approx(0.05, rel=0.1)


def test_they_come_in_by_arrival_and_some_are_lost() -> None:
    arrived = [one.t for one in datagrams(Load(reporters=8, neighbours=4, loss=0.3), 4, OWN, 0.0, 20.0)]
    assert all(a <= b for a, b in pairwise(arrived))
    assert len(arrived) == pytest.approx(0.7 * 8 * 10 * 20, rel=0.1)


def test_more_ranges_than_a_datagram_holds_go_in_several() -> None:
    load = Load(reporters=80, neighbours=2 * (MAX_RANGES + 4), hz=2.0)
    sizes = {len(decode_ranges(one.payload, KEYS).ranges) for one in datagrams(load, 4, OWN, 0.0, 1.0)}
    assert sizes == {MAX_RANGES, 4}


def test_a_receiver_takes_all_and_one_who_lies_moves_nobody() -> None:
    told = wire_load.row(Load(reporters=8, neighbours=4, ahead={2: 0.4}), 10.0)
    assert told["refused"] == {}
    assert told["datagrams a second"] == 80
    assert float(str(told["largest"])) < 1.0
