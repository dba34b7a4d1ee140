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
from typing import IO, NamedTuple

from synchronizar.errors import InputError
from synchronizar.live.scenario import Scenario

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


class Said(NamedTuple):
    """What a module does from now on."""

    t: float
    """s, simulated."""
    module: int
    """Its address."""
    what: str


def events(scenario: Scenario, frames: bool = False) -> Iterator[Datagram | Frame | Said]:
    """What happens in a scenario, in the order of time; datagrams come by UDP, frames are told if asked for.

    The simulated air stands still while a datagram is being looked at. Raises InputError where the program is not
    there, does not take the scenario, or fails.
    """
    command = [program(), *(["--frames"] if frames else [])]
    with (
        tempfile.TemporaryDirectory() as folder,
        tempfile.TemporaryFile() as faults,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as collector,
    ):
        collector.bind((HOST, 0))
        collector.settimeout(WAIT_S)
        file = Path(folder) / "scenario"
        file.write_text(scenario.text(), encoding="ascii")
        command += [str(file), "--port", str(collector.getsockname()[1])]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=faults, encoding="utf-8") as process:
            try:
                yield from _heard(process, collector)
            except (_UnexpectedError, OSError) as fault:
                process.kill()
                raise InputError(PROGRAM, _told(faults) or str(fault)) from fault
            finally:
                process.kill()


class _UnexpectedError(Exception):
    """The program did not do as agreed."""


def _heard(process: subprocess.Popen[str], collector: socket.socket) -> Iterator[Datagram | Frame | Said]:
    assert process.stdin is not None
    assert process.stdout is not None
    done = False
    for line in process.stdout:
        match line.split():
            case ["sent", t, _, size]:
                yield Datagram(float(t), _received(collector, int(size)))
                # Past the pipe's buffer, in which an answer to a program that has ended would stay.
                os.write(process.stdin.fileno(), b"\n")
            case ["frame", begin, end, sender, slot, kind]:
                yield Frame(float(begin), float(end), int(sender), None if slot == "-" else int(slot), kind)
            case ["said", t, "node", module, *words]:
                yield Said(float(t), int(module), " ".join(words))
            case ["done"]:
                done = True
            case _:
                raise _UnexpectedError(f"said '{line.strip()}', which means nothing here")
    if (status := process.wait()) != 0 or not done:
        raise _UnexpectedError(f"ended with status {status}{'' if done else ' before it was done'}")


def _received(collector: socket.socket, size: int) -> bytes:
    try:
        payload = collector.recv(MAX_DATAGRAM)
    except TimeoutError as error:
        raise _UnexpectedError(f"said that it sent a datagram, and none came within {WAIT_S:g} s") from error
    if len(payload) != size:
        raise _UnexpectedError(f"said that it sent {size} bytes, and {len(payload)} came")
    return payload


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
