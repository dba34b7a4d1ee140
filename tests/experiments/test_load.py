from __future__ import annotations

import numpy as np

from experiments.common.cpu import Usage
from experiments.live import kills, load
from synchronizar.live import messages as m
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate


def test_each_pair_of_neighbours_is_measured_once_and_each_device_has_ten() -> None:
    for total, air in ((32, 11), (32, 0), (64, 11)):
        pairs = [(d, peer) for d in range(total) for peer in load.neighbours(d, total, air)]
        assert len(pairs) == len({frozenset(pair) for pair in pairs})
        flown = [(a, b) for a in range(air) for b in range(a)]
        partners = [sum(d in pair for pair in [*pairs, *flown]) for d in range(total)]
        assert set(partners[air:]) == {2 * load.EACH_SIDE}
        assert min(partners) >= 2 * load.EACH_SIDE


def test_a_line_tells_delays_and_words_that_were_lost() -> None:
    delays = np.zeros(load.BINS_MS, dtype=np.int64)
    delays[20], delays[45], delays[90] = 80, 19, 1
    heard = [
        load.Heard(delays, {"a one": 3, "a all": 3}, {("b", "a one"): [0, 1, 2], ("b", "a all"): [0, 2]}, 1.0, 5),
        load.Heard(np.zeros_like(delays), {"b one": 2}, {("a", "b one"): [0, 1]}, 2.0, 5),
    ]
    seen = [
        load.Moment(t, Usage(0.5 * t, 50.0 + t), Usage(0.9 * t, 100.0), Usage(0.25 * t, 9.0), 0.01 * t, 1 + (t > 5.0))
        for t in (1.0, 61.0, 121.0)
    ]
    row = load.row_of(2, load.Load([m.Lag(1.0, 9.0), m.Lag(2.0, 7.0)], seen, heard, 2, {"rate": 1}, 3.0))
    assert (row["poses p50 ms"], row["poses p99 ms"]) == (20, 45)
    assert (row["loop p50 ms"], row["loop p99 ms"]) == (2.0, 9.0)
    assert (row["words"], row["words lost"]) == (7, 1)
    assert (row["server cores"], row["solver cores"], row["search cores"]) == (0.5, 0.9, 0.25)
    assert (row["at most"], row["all registered after s"]) == (1.21, 61)
    assert (row["server MB, 1st minute"], row["server MB, end"]) == (111.0, 171.0)
    assert load.broken(row) == ["words"]


def test_what_is_not_in_the_recording_is_as_old_as_it_was_at_the_next_kill() -> None:
    recording = simulate(Scene(users=2, seconds=2.0)).recording
    first = kills._key(next(iter(recording.tracks.values())).position[0].tolist())
    nowhere = ("9.000000000",)
    killed = [kills.Killed(20.0, 1.0, 0, 22.0)]
    said = [kills.Said(10.0, first), kills.Said(18.0, nowhere), kills.Said(19.5, nowhere), kills.Said(21.0, nowhere)]
    assert kills.lost(said, recording, killed, 30.0) == (2.0, 1)
    assert kills.lost([*said, kills.Said(23.0, nowhere)], recording, killed, 30.0) == (7.0, 2)
