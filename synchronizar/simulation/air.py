"""The simulated air in which the modules' firmware runs: a program, and the datagrams that its modules send."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sysconfig
import tempfile
from collections.abc import Iterator
from pathlib import Path
from time import monotonic
from typing import IO, NamedTuple

from synchronizar.errors import InputError
from synchronizar.io.datagrams import WireError, decode_ranges
from synchronizar.simulation.scenario import Scenario

PROGRAM = "synchronizar-air"
HOST = "127.0.0.1"
WAIT_S = 5.0
"""For a datagram that the program says it has sent: on the loopback it is there at once."""
MAX_DATAGRAM = 65535


class Datagram(NamedTuple):
    """What a collector receives."""

    t: float
    """s, simulated: when it came."""
    payload: bytes
    measured: float
    """s, simulated: when the newest range in it was measured; NaN where it has none, or where its module has left the
    network of which they are."""


class Frame(NamedTuple):
    """A frame on air."""

    begin: float
    """s, simulated."""
    end: float
    sender: int
    """Its address."""
    slot: int | None
    """Of the round; None: it has none."""
    kind: str
    """`word`, `join`, or `other`."""


def events(scenario: Scenario, frames: bool = False) -> Iterator[Datagram | Frame]:
    """What happens in a scenario, in the order of time; datagrams come by UDP, frames are told if asked for.

    The simulated air stands still while a datagram is being looked at. Raises InputError where the program is not
    there, does not take the scenario, or fails.
    """
    command = [program(), *(["--frames"] if frames else [])]
    try:
        yield from _run(command, scenario)
    except (OSError, ValueError) as fault:
        raise InputError(PROGRAM, str(fault)) from fault


def _run(command: list[str], scenario: Scenario) -> Iterator[Datagram | Frame]:
    """What the program says. Raises OSError or ValueError where something is wrong."""
    # Neither file has a name: the scenario holds the session's key, and must not be left behind by whatever ends this.
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
                    yield from _heard(process, collector, scenario.key)
                finally:
                    process.kill()
        except (OSError, ValueError) as fault:
            raise ValueError(_told(faults).replace(file, "scenario") or str(fault)) from fault


def _heard(process: subprocess.Popen[str], collector: socket.socket, key: bytes) -> Iterator[Datagram | Frame]:
    assert process.stdin is not None
    assert process.stdout is not None
    done = False
    for line in process.stdout:
        match line.split():
            case ["sent", t, module, size, measured]:
                payload = _received(collector, int(module), int(size), key)
                yield Datagram(float(t), payload, float("nan") if measured == "-" else float(measured))
                # Past the pipe's buffer, in which an answer to a program that has ended would stay.
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


def _received(collector: socket.socket, module: int, size: int, key: bytes) -> bytes:
    """The datagram that a module has sent; what strangers send to the port is passed over."""
    until = monotonic() + WAIT_S
    while (left := until - monotonic()) > 0.0:
        collector.settimeout(left)
        try:
            payload = collector.recv(MAX_DATAGRAM)
        except TimeoutError:
            break
        if len(payload) == size and _is_from(module, payload, key):
            return payload
    raise ValueError(f"said that it sent a datagram of {module}, and none came within {WAIT_S:g} s")


def _is_from(module: int, payload: bytes, key: bytes) -> bool:
    try:
        return decode_ranges(payload, key).reporter == module
    except WireError:
        return False


def _told(faults: IO[bytes]) -> str:
    """The last line of what the program said was wrong."""
    faults.seek(0)
    lines = faults.read().decode("utf-8", "replace").splitlines()
    return lines[-1].removeprefix(f"{PROGRAM}: ") if lines else ""


def program() -> str:
    """The program: installed beside this Python, or else on the path. Raises InputError where it is in neither."""
    found = shutil.which(Path(sysconfig.get_path("scripts")) / PROGRAM) or shutil.which(PROGRAM)
    if found is None:
        raise InputError(PROGRAM, "is not there: it comes with the package where that is built with -DFIRMWARE=ON")
    return found
