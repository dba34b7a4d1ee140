"""Runs the simulated air of the modules' firmware, a program, and receives the datagrams that its modules send."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sysconfig
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import IO, NamedTuple

from synchronizar.errors import InputError
from synchronizar.io.datagrams import KeyOf, WireError, decode_ranges
from synchronizar.simulation.scenario import Scenario

PROGRAM = "synchronizar-air"
HOST = "127.0.0.1"
WAIT_S = 5.0
"""s: longest wait for a datagram that the program reports as sent; on the loopback it arrives at once."""
MAX_DATAGRAM = 65535


class Datagram(NamedTuple):
    """A datagram as a collector receives it."""

    t: float
    """s, simulated: arrival."""
    payload: bytes
    measured: float
    """s, simulated: measurement of its newest range; NaN where it has no range, or where its module has left the
    network that they belong to."""


class Frame(NamedTuple):
    """A frame on air."""

    begin: float
    """s, simulated."""
    end: float
    sender: int
    """Address of the sender."""
    slot: int | None
    """Slot of the round; None where it has none."""
    kind: str
    """`word`, `join`, or `other`."""


def events(scenario: Scenario, frames: bool = False) -> Iterator[Datagram | Frame]:
    """Datagrams of a scenario in the order of time, and with `frames` the frames on air.

    Datagrams come by UDP; simulated time stops while the caller processes one. Raises InputError where the program is
    missing, refuses the scenario, or fails.
    """
    command = [program(), *(["--frames"] if frames else [])]
    try:
        yield from _run(command, scenario)
    except (OSError, ValueError) as fault:
        raise InputError(PROGRAM, str(fault)) from fault


def _run(command: list[str], scenario: Scenario) -> Iterator[Datagram | Frame]:
    """Run the program and yield its events. Raises OSError or ValueError where it fails."""
    # Neither file has a name: the scenario holds the session's key, and no end of this process may leave it behind.
    with (
        tempfile.TemporaryFile() as text,
        tempfile.TemporaryFile() as faults,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as collector,
    ):
        text.write(scenario.text().encode("ascii"))
        text.seek(0)
        collector.bind((HOST, 0))
        file = f"/dev/fd/{text.fileno()}"
        command = [*command, file, "--port", str(collector.getsockname()[1])]
        pipe = subprocess.PIPE
        try:
            with subprocess.Popen(
                command,
                stdin=pipe,
                stdout=pipe,
                stderr=faults,
                encoding="ascii",
                errors="backslashreplace",
                pass_fds=[text.fileno()],
            ) as process:
                try:
                    yield from _parsed(process, collector, scenario.keys())
                finally:
                    process.kill()
        except (OSError, ValueError) as fault:
            raise ValueError(_last_fault(faults).replace(file, "scenario") or str(fault)) from fault


def _parsed(process: subprocess.Popen[str], collector: socket.socket, key_of: KeyOf) -> Iterator[Datagram | Frame]:
    """Events from the lines that the program prints. Raises ValueError where it ends early or with an error."""
    assert process.stdin is not None
    assert process.stdout is not None
    done = False
    for line in process.stdout:
        match line.split():
            case ["sent", t, module, size, measured]:
                payload = _received(collector, int(module), int(size), key_of)
                yield Datagram(float(t), payload, float("nan") if measured == "-" else float(measured))
                # Not through the pipe's buffer, which would keep a reply to a program that has ended. That it has, and
                # how, is told below.
                with suppress(BrokenPipeError):
                    os.write(process.stdin.fileno(), b"\n")
            case ["frame", begin, end, sender, slot, kind]:
                yield Frame(float(begin), float(end), int(sender), None if slot == "-" else int(slot), kind)
            case ["said", *_]:
                pass
            case ["done"]:
                done = True
            case _:
                raise ValueError(f"said '{line.strip()}', which means nothing here")
    if (status := process.wait()) != 0 or not done:
        raise ValueError(f"ended with status {status}{'' if done else ' before it was done'}")


def _received(collector: socket.socket, module: int, size: int, key_of: KeyOf) -> bytes:
    """The datagram that a module has sent; datagrams of others to the port are skipped."""
    until = monotonic() + WAIT_S
    while (left := until - monotonic()) > 0.0:
        collector.settimeout(left)
        try:
            payload = collector.recv(MAX_DATAGRAM)
        except TimeoutError:
            break
        if len(payload) == size and _is_from(module, payload, key_of):
            return payload
    raise ValueError(f"said that it sent a datagram of {module}, and none came within {WAIT_S:g} s")


def _is_from(module: int, payload: bytes, key_of: KeyOf) -> bool:
    try:
        return decode_ranges(payload, key_of).reporter == module
    except WireError:
        return False


def _last_fault(faults: IO[bytes]) -> str:
    """The last line that the program wrote to stderr."""
    faults.seek(0)
    lines = faults.read().decode("utf-8", "replace").splitlines()
    return lines[-1].removeprefix(f"{PROGRAM}: ") if lines else ""


def program() -> str:
    """Path of the program: beside this Python, else on PATH. Raises InputError where it is in neither."""
    found = shutil.which(Path(sysconfig.get_path("scripts")) / PROGRAM) or shutil.which(PROGRAM)
    if found is None:
        raise InputError(PROGRAM, "is not there: it comes with the package where that is built with -DFIRMWARE=ON")
    return found
