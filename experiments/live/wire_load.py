"""Datagrams of any number of reporters with truth, by the wire codec alone: one network of modules holds eleven.

`python -m experiments.live.wire_load [--reporters 32] [--neighbours 10] [--hz 10] [--seconds 60] [--loss 0.0]
[--liar] [--seed 0]`: as fast as they can be taken, to a receiver in this process. Told are datagrams and ranges a
second, CPU a datagram, by how much stamps are off the moment of the measurement once each clock is set (its mean taken
out), and memory at the quarters' ends. `--liar`: one reporter tells times that are 0.4 s ahead; it is left out of the
errors.
"""

from __future__ import annotations

import argparse
import heapq
from collections.abc import Iterator, Mapping
from itertools import count
from time import process_time
from typing import NamedTuple

import numpy as np

from experiments.common.cpu import resident_mb
from experiments.common.markdown import markdown
from experiments.live.air import place
from synchronizar.arrays import Array
from synchronizar.io.datagrams import (
    MAX_RANGES,
    RANGE,
    UNKNOWN_CLOCK,
    UNKNOWN_POWER,
    RangesDatagram,
    RoomKeys,
    encode_ranges,
)
from synchronizar.io.receiver import Receiver

LEAST_DELAY_S, MORE_DELAY_S = 0.0015, 0.0015
"""Of Wi-Fi, as in the simulated air: the least, and on average more than that."""
SIGHT_CLEAR = 0
QUARTERS = 4
AHEAD_S = 0.4


class Load(NamedTuple):
    """Who tells how much."""

    reporters: int = 32
    neighbours: int = 10
    """With so many each ranges, those whose numbers are next to its own; each distance is told once."""
    hz: float = 10.0
    """Ranges of a pair a second; a reporter's ranges of a round are one datagram, or as many as they fill."""
    sigma: float = 0.05
    """m."""
    loss: float = 0.0
    """Share of datagrams that do not come in."""
    ppm: float = 20.0
    """By how much the network's clock is fast."""
    ahead: Mapping[int, float] = {}
    """s: reporters that tell times which are ahead."""
    seed: int = 0


class Told(NamedTuple):
    """A datagram as it comes in."""

    t: float
    """s: arrival."""
    reporter: int
    payload: bytes
    measured: Array
    """(n,) s: when its ranges were measured."""


def datagrams(load: Load, session: int, keys: Mapping[int, bytes], begin: float, end: float) -> Iterator[Told]:
    """All that comes in between two moments (s), by arrival; addresses are 0 to `reporters` - 1, each with its key.

    People walk as `experiments.live.air.place` has it: truth is `place(seed, address, t)`.
    """
    random = np.random.default_rng(load.seed)
    phase, numbers = random.uniform(0.0, 1.0, load.reporters), count()
    sequence = [0] * load.reporters
    epoch, epoch_ns = int(random.integers(2**32)), int(random.integers(2**50))
    partners = [_partners(load, reporter) for reporter in range(load.reporters)]
    waiting: list[tuple[float, int, Told]] = []
    for number in range(round((end - begin) * load.hz)):
        first = begin + number / load.hz
        while waiting and waiting[0][0] <= first:
            yield heapq.heappop(waiting)[2]
        for reporter, peers in enumerate(partners):
            for some in (peers[at : at + MAX_RANGES] for at in range(0, len(peers), MAX_RANGES)):
                t = first + (phase[reporter] + np.sort(random.uniform(0.0, 0.2, len(some)))) / load.hz
                sequence[reporter] += 1
                if random.uniform() < load.loss:
                    continue
                arrived = float(t.max()) + LEAST_DELAY_S + MORE_DELAY_S * random.standard_exponential()
                clock_ns = epoch_ns + np.round(1e9 * (t * (1.0 + 1e-6 * load.ppm) + load.ahead.get(reporter, 0.0)))
                ranges = _ranges(random, load, reporter, some, t)
                ranges["offset_us"] = np.round(1e-3 * (clock_ns - clock_ns[0]))
                said = RangesDatagram(session, reporter, sequence[reporter], epoch, int(clock_ns[0]), 0, ranges)
                told = Told(arrived, reporter, encode_ranges(said, keys[reporter]), t)
                heapq.heappush(waiting, (arrived, next(numbers), told))
    while waiting:
        yield heapq.heappop(waiting)[2]


def _partners(load: Load, reporter: int) -> np.ndarray:
    """Those whose distances a reporter tells: half of its neighbours, as the others tell the rest."""
    n = load.reporters
    away = 1 + np.arange(min(load.neighbours // 2, n // 2))
    if reporter >= n // 2:
        away = away[2 * away != n]  # one from the other side of the ring has told that distance
    return (reporter + away) % n


def _ranges(random: np.random.Generator, load: Load, reporter: int, peers: np.ndarray, t: Array) -> np.ndarray:
    ranges = np.zeros(len(peers), RANGE)
    own = place(load.seed, reporter, t).T
    others = np.array([place(load.seed, int(peer), at) for peer, at in zip(peers, t.tolist(), strict=True)])
    distance = np.linalg.norm(own - others, axis=1) + load.sigma * random.standard_normal(len(peers))
    ranges["peer"], ranges["distance_mm"] = peers, np.round(1000.0 * distance)
    ranges["sigma_mm"], ranges["clock_ppb"], ranges["sight"] = round(1000.0 * load.sigma), UNKNOWN_CLOCK, SIGHT_CLEAR
    ranges["rx_power_cdbm"] = ranges["fp_power_cdbm"] = UNKNOWN_POWER
    return ranges


def row(load: Load, seconds: float) -> dict[str, object]:
    """What a receiver makes of a load."""
    keys = RoomKeys(load.seed, np.random.default_rng(load.seed).bytes(32))
    own = {reporter: keys.of(reporter) for reporter in range(load.reporters)}
    receiver, cpu, came, ranges = Receiver(keys), 0.0, 0, 0
    megabytes, next_quarter = [], seconds / QUARTERS
    moments: dict[tuple[int, int], float] = {}
    off: list[float] = []
    for number, told in enumerate(datagrams(load, load.seed, own, 0.0, seconds)):
        before = process_time()
        taken = receiver.take(told.payload, told.t)
        cpu += process_time() - before
        came = number + 1
        if taken is None:
            continue
        moments[told.reporter, taken.datagram.sequence] = float(told.measured[0])
        for datagram, t in taken.stamped:
            ranges += len(t)
            moment = moments.pop((datagram.reporter, datagram.sequence))
            if datagram.reporter not in load.ahead:
                off.append(float(t[0]) - moment)
        if told.t >= next_quarter:
            next_quarter += seconds / QUARTERS
            megabytes.append(resident_mb())
    errors = np.array(off) - np.mean(off)
    return {
        "reporters": load.reporters,
        "datagrams a second": round(came / seconds),
        "ranges a second": round(ranges / seconds),
        "us a datagram": round(1e6 * cpu / came),
        "cores": f"{cpu / seconds:.3f}",
        "stamps off, ms: sd": f"{1e3 * errors.std():.2f}",
        "largest": f"{1e3 * np.abs(errors).max():.2f}",
        "refused": dict(receiver.refused),
        "MB at the quarters' ends": " ".join(f"{mb:.0f}" for mb in megabytes),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reporters", type=int, nargs="+", default=[32])
    parser.add_argument("--neighbours", type=int, default=10)
    parser.add_argument("--hz", type=float, default=10.0)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--liar", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    ahead = {0: AHEAD_S} if options.liar else {}
    loads = [
        Load(n, options.neighbours, options.hz, loss=options.loss, ahead=ahead, seed=options.seed)
        for n in options.reporters
    ]
    print(markdown([row(load, options.seconds) for load in loads]))


if __name__ == "__main__":
    main()
