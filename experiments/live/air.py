"""The live air: how many ranges a second, how late they are, what they cost.

`python -m experiments.live.air [--seconds 20] [--seed 0]`: 3, 8 and 11 modules on people who walk loops, each place
told 60 times a second with the moment it is of (the wall clock), ranges by one to n, good to 3 cm, over real UDP to a
receiver in this process. Told are ranges a second; by how much later than they were measured ranges came in; by how
much their stamps are later than the measurement, mean and standard deviation, and the largest distance from that mean
after the first 3 s; errors of ranges at the measured moment; CPU of the air and of the receiver, as shares of a core,
and time a datagram.
"""

from __future__ import annotations

import argparse
import resource
import socket
from collections import defaultdict
from time import monotonic, process_time, sleep
from typing import NamedTuple

import numpy as np

from experiments.common.markdown import markdown
from synchronizar.arrays import Array
from synchronizar.io.datagrams import RoomKeys
from synchronizar.io.receiver import Receiver, Stamped
from synchronizar.simulation.live_air import Carried, LiveAir, Sent
from synchronizar.simulation.modules import CRYSTAL_PPM, RANGE_OF_STAMP

MODULES = (3, 8, 11)
PLACES_HZ = 60.0
SIGMA_M = 0.03
STEADY_S = 3.0
PAUSE_S = 0.002
ROOM_M = (6.0, 4.0)


class Arrived(NamedTuple):
    """A datagram whose ranges are stamped."""

    stamped: Stamped
    arrived: float
    """s: when it came in, not when it was stamped."""


class Run(NamedTuple):
    """One session."""

    arrived: list[Arrived]
    measured: dict[tuple[int, int], float]
    """s: when the newest range of a module's datagram was measured, by address and number of the datagram."""
    air_cpu: float
    """s of CPU."""
    receiver_cpu: float
    datagrams: int
    refused: int


def place(seed: int, module: int, t: float | Array) -> Array:
    """(3,) or (3, n) m: loops through the room, each module's at its own pace, up to 1.5 m/s."""
    random = np.random.default_rng([seed, module])
    rate, phase, height = random.uniform(0.15, 0.3, 2), random.uniform(0.0, 2.0 * np.pi, 2), random.uniform(1.0, 1.6)
    along = [0.5 * width * np.sin(r * t + p) for width, r, p in zip(ROOM_M, rate, phase, strict=True)]
    return np.array([*along, height + 0.0 * np.asarray(t)])


def run(modules: int, seconds: float, seed: int) -> Run:
    """A session in real time."""
    random = np.random.default_rng(seed)
    keys = RoomKeys(seed, random.bytes(32))
    receiver = Receiver(keys)
    sent: defaultdict[int, list[float]] = defaultdict(list)
    came: defaultdict[int, list[int]] = defaultdict(list)
    arrivals: dict[tuple[int, int], float] = {}
    arrived: list[Arrived] = []
    cpu = 0.0

    def on_sent(datagram: Sent) -> None:
        sent[datagram.module].append(datagram.measured)

    children = _children_cpu()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as collector:
        collector.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        collector.bind(("127.0.0.1", 0))
        collector.setblocking(False)
        port, sigma = collector.getsockname()[1], SIGMA_M / RANGE_OF_STAMP
        with LiveAir(seed, port, seed, stamp_sigma=sigma, on_sent=on_sent) as air:
            for module in range(modules):
                air.add(module, Carried(keys.of(module), *random.uniform(-CRYSTAL_PPM, CRYSTAL_PPM, 2).tolist()))
            begin, told = monotonic(), 0
            while (now := monotonic() - begin) < seconds:
                while told <= now * PLACES_HZ:
                    t = told / PLACES_HZ
                    air.places(t, {module: place(seed, module, t) for module in range(modules)})
                    told += 1
                before = process_time()
                while (datagram := _received(collector)) is not None:
                    now = monotonic() - begin
                    taken = receiver.take(datagram, now)
                    if taken is None:
                        continue
                    came[taken.datagram.reporter].append(taken.datagram.sequence)
                    arrivals[taken.datagram.reporter, taken.datagram.sequence] = now
                    for one in taken.stamped:
                        of = one.datagram.reporter, one.datagram.sequence
                        arrived.append(Arrived(one, arrivals[of]))
                cpu += process_time() - before
                sleep(PAUSE_S)
    measured = {
        (module, sequence): moment
        for module, sequences in came.items()
        for sequence, moment in zip(sequences, sent[module], strict=False)
    }
    refused = receiver.refused.total()
    return Run(arrived, measured, _children_cpu() - children, cpu, sum(map(len, came.values())), refused)


def _received(collector: socket.socket) -> bytes | None:
    try:
        return collector.recv(2048)
    except BlockingIOError:
        return None


def _children_cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def row(modules: int, seconds: float, seed: int) -> dict[str, object]:
    """What became of one session."""
    of = run(modules, seconds, seed)
    late, stamps, times, errors = [], [], [], []
    ranges = 0
    for (datagram, t), arrived in of.arrived:
        ranges += len(t)
        moment = of.measured[datagram.reporter, datagram.sequence]
        if not np.isfinite(moment):
            continue
        at = moment + t - t.max()  # within a datagram the network's clock tells the moments apart
        late += (arrived - at).tolist()
        stamps.append(float(t.max()) - moment)
        times.append(moment)
        for peer, distance, when in zip(datagram.ranges["peer"], datagram.ranges["distance_mm"], at, strict=True):
            true = np.linalg.norm(place(seed, datagram.reporter, when) - place(seed, int(peer), when))
            errors.append(1e-3 * float(distance) - float(true))
    stamped, steady = np.array(stamps), np.array(times) > STEADY_S
    return {
        "modules": modules,
        "ranges a second": round(ranges / seconds),
        "came in after, ms: median, p95": "{:.0f}, {:.0f}".format(*1e3 * np.percentile(late, [50, 95])),
        "stamped after, ms": f"{1e3 * stamped[steady].mean():.1f} +- {1e3 * stamped[steady].std():.2f}",
        "farthest from that, ms": f"{1e3 * np.abs(stamped[steady] - stamped[steady].mean()).max():.1f}",
        "error, cm": f"{100 * np.mean(errors):+.1f} +- {100 * np.std(errors):.1f}",
        "largest, cm": f"{100 * np.abs(errors).max():.0f}",
        "air, cores": f"{of.air_cpu / seconds:.3f}",
        "receiver, cores": f"{of.receiver_cpu / seconds:.3f}",
        "us a datagram": round(1e6 * of.receiver_cpu / of.datagrams),
        "refused": of.refused,
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(markdown([row(modules, options.seconds, options.seed) for modules in MODULES]))


if __name__ == "__main__":
    main()
