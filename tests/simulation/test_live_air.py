"""The air that is steered while it runs. Nothing is judged by wall time: what is waited for comes, or it fails."""

from __future__ import annotations

import socket
import subprocess
import sys
import sysconfig
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest
from support.air_built import needs_air

from synchronizar.errors import InputError
from synchronizar.io.datagrams import OrderDatagram, RoomKeys, encode_order
from synchronizar.io.receiver import Receiver, Taken
from synchronizar.simulation import air, live_air
from synchronizar.simulation.live_air import Carried, LiveAir

SESSION = 5
KEYS = RoomKeys(SESSION, bytes(range(32)))
PATIENCE_S = 120.0


class Collector:
    """A UDP port with a receiver, to which a datagram comes each second, for want of a simulated clock."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.port = self.socket.getsockname()[1]
        self.receiver = Receiver(KEYS)
        self.taken: list[tuple[Taken, tuple[str, int]]] = []

    def collect(self) -> None:
        while True:
            try:
                datagram, sender = self.socket.recvfrom(2048)
            except BlockingIOError:
                return
            taken = self.receiver.take(datagram, float(len(self.taken)))
            assert taken is not None
            self.taken.append((taken, sender))

    def distances(self, a: int, b: int) -> list[float]:
        """m: all between two modules so far."""
        self.collect()
        found: list[float] = []
        for taken, _ in self.taken:
            said = taken.datagram
            if said.reporter in {a, b}:
                peer = ({a, b} - {said.reporter}).pop()
                found += (0.001 * said.ranges["distance_mm"][said.ranges["peer"] == peer]).tolist()
        return found


@pytest.fixture
def collector() -> Iterator[Collector]:
    collector = Collector()
    yield collector
    collector.socket.close()


def wait_for(what: Callable[[], bool]) -> None:
    until = monotonic() + PATIENCE_S
    while not what():
        assert monotonic() < until, "it does not come"
        sleep(0.005)


def walk(air: LiveAir, begin: float, end: float, places: dict[int, tuple[float, float, float]]) -> None:
    """Everybody is at rest from begin to end, and tells it 20 times a second."""
    for t in np.arange(begin, end, 0.05).tolist():
        air.places(t, places)


@needs_air
def test_modules_come_range_and_go(collector: Collector) -> None:
    with LiveAir(SESSION, collector.port, stamp_sigma=0.0) as live:
        for address in (1, 2, 3):
            live.add(address, Carried(KEYS.of(address), ppm=5.0 * address))
        walk(live, 0.0, 3.0, {1: (0.0, 0.0, 1.0), 2: (3.0, 4.0, 1.0)})
        # All of it: what nobody takes for longer, a system with small buffers drops.
        wait_for(lambda: len(collector.distances(1, 2)) > 300 and live.t > 2.9)
        np.testing.assert_allclose(collector.distances(1, 2), 5.0, atol=0.03)
        assert collector.distances(1, 3) == [], "it has no place yet"
        walk(live, 3.0, 6.0, {1: (0.0, 0.0, 1.0), 2: (3.0, 4.0, 1.0), 3: (0.0, 0.0, 3.0)})
        wait_for(lambda: len(collector.distances(1, 3)) > 200)
        np.testing.assert_allclose(collector.distances(1, 3), 2.0, atol=0.03)
        live.off(3)
        wait_for(lambda: live.states[3] == "has no power")
        assert live.t < 6.0
    collector.collect()
    assert live.datagrams == len(collector.taken)
    assert not live.faults
    assert {reporter for reporter, known in collector.receiver.reporters.items() if known.ranges} <= {1, 2, 3}


@needs_air
def test_a_detour_is_there_as_long_as_it_is_told(collector: Collector) -> None:
    with LiveAir(SESSION, collector.port, stamp_sigma=0.0) as live:
        for address in (1, 2):
            live.add(address, Carried(KEYS.of(address)))
        live.block(1, 2, 1.0, 2.0, 1.5)
        walk(live, 0.0, 3.0, {1: (0.0, 0.0, 1.0), 2: (4.0, 0.0, 1.0)})
        wait_for(lambda: live.t > 2.9)
    distances = np.array(collector.distances(1, 2))
    assert 0.2 < np.mean(np.abs(distances - 5.5) < 0.06) < 0.6
    assert 0.3 < np.mean(np.abs(distances - 4.0) < 0.06) < 0.8


@needs_air
def test_a_module_is_ordered_to_sleep_and_wakes_again(collector: Collector) -> None:
    with LiveAir(SESSION, collector.port) as live:
        for address in (1, 2):
            live.add(address, Carried(KEYS.of(address)))
        places = {1: (0.0, 0.0, 1.0), 2: (4.0, 0.0, 1.0)}
        walk(live, 0.0, 3.0, places)
        wait_for(lambda: live.t > 2.9)
        collector.collect()
        said, way = next((taken.datagram, way) for taken, way in collector.taken if taken.datagram.reporter == 2)
        for key in (KEYS.of(1), KEYS.of(2)):  # of the wrong module first
            order = OrderDatagram(SESSION, 2, said.sequence, 4)
            collector.socket.sendto(encode_order(order, key), way)
        walk(live, 3.0, 5.0, places)
        wait_for(lambda: live.states[2] == "sleeps")
        walk(live, 5.0, 9.0, places)
        wait_for(lambda: live.states[2] in {"is a member", "coordinates"})


@needs_air
def test_a_line_that_means_nothing_is_told_and_ignored(collector: Collector) -> None:
    with LiveAir(SESSION, collector.port) as live:
        live.place(1, 0.0, (0.0, 0.0, 0.0))
        live.add(1, Carried(KEYS.of(1)))
        live.place(1, 0.0, (0.0, np.nan, 0.0))
        live.place(1, 2.0, (0.0, 0.0, 0.0))
        wait_for(lambda: len(live.faults) == 2)
        walk(live, 2.1, 4.0, {1: (0.0, 0.0, 0.0)})
        wait_for(lambda: live.datagrams > 0)
    assert list(live.faults) == [
        "line 1: there is no module 1",
        "line 3: a coordinate is nan, not from -1e+06 to 1e+06",
    ]


@needs_air
def test_whatever_lines_say_it_goes_on(collector: Collector) -> None:
    """Anything on standard input: each line that means nothing is answered by one, and those that do are followed."""
    random = np.random.default_rng(4)
    text = "module at stay off blocked 1 2 65534 -1 1e308 nan inf 0.5 23 ppm board_ppm antenna_delay_error temperature"
    words = [*text.encode().split(), KEYS.of(1).hex().encode(), b"\0", b"\xff"]
    lines = [b" ".join(random.choice(words, random.integers(1, 12)).tolist()) for _ in range(3000)]
    lines.append(b"x" * 100_000)
    with LiveAir(SESSION, collector.port) as live:
        live._behind += b"\n".join(lines) + b"\n"

        def all_is_read() -> bool:
            live.stay(9)
            return any(fault.endswith("there is no module 9") for fault in live.faults)

        wait_for(all_is_read)
        live.add(3, Carried(KEYS.of(3)))
        walk(live, 0.0, 3.0, {3: (0.0, 0.0, 0.0)})
        wait_for(lambda: live.states.get(3) == "coordinates")


@needs_air
def test_what_it_cannot_be_started_with_is_told() -> None:
    with LiveAir(SESSION, 1, scheme="round-robin") as live:
        wait_for(lambda: bool(live.faults))
        wait_for(lambda: live._process.poll() is not None)
        with pytest.raises(InputError, match="the scheme is 'round-robin', not one-to-n"):
            live.stay(1)


def test_a_program_that_does_not_keep_up_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / air.PROGRAM
    program.write_text(f"#!{sys.executable}\n" + textwrap.dedent("import time\ntime.sleep(60)\n"))
    program.chmod(0o755)
    monkeypatch.setattr(sysconfig, "get_path", lambda _: str(tmp_path))
    monkeypatch.setattr(live_air, "MOST_BEHIND", 1 << 12)
    monkeypatch.setattr(live_air, "END_S", 0.05)
    with LiveAir(SESSION, 1) as live, pytest.raises(InputError, match="does not keep up"):
        walk(live, 0.0, 5000.0, {1: (0.0, 0.0, 0.0)})
    assert live._process.poll() is not None


@needs_air
def test_the_end_of_all_lines_is_the_end_when_all_is_run(tmp_path: Path) -> None:
    settings = tmp_path / "settings"
    settings.write_text(f"air 1\nsession {SESSION}\n")
    module = f"module 1 {KEYS.of(1).hex()} ppm 0 board_ppm 0 antenna_delay_error 0 temperature 23\n"
    run = subprocess.run(
        [air.program(), settings, "--port", "9", "--live"],
        input=module + "at 1 0 0 0 0\nat 1 5 0 0 0\nnot a line",
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
    )
    lines = run.stdout.splitlines()
    assert lines[-1] == "done"
    assert 4.0 < float(lines[-2].split()[1]) < 5.0
    assert run.stderr == ""
