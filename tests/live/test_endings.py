"""Whoever is killed leaves no process behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from synchronizar.live import messages as m
from synchronizar.live.solver_wire import (
    LENGTH,
    AddUser,
    Advance,
    Begin,
    Block,
    Command,
    Pose,
    Range,
    Told,
    framed,
    reply_decoder,
)
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="asks Linux for a process's children")


def commands() -> list[Command]:
    """Two who walk for long enough that a search begins."""
    recording = simulate(Scene(users=2, seconds=3.0, seed=1)).recording
    names = [user.name for user in recording.users]
    said: list[tuple[float, Command]] = [
        (t, Pose(name, t, tuple(xyz), tuple(quat)))
        for name, track in recording.tracks.items()
        for t, xyz, quat in zip(track.t.tolist(), track.position.tolist(), track.quat_xyzw.tolist(), strict=True)
    ]
    r = recording.ranges
    said += [
        (t, Range(t, names[a], names[b], distance, {}))
        for t, a, b, distance in zip(r.t.tolist(), r.a.tolist(), r.b.tolist(), r.distance.tolist(), strict=True)
    ]
    said.sort(key=lambda one: one[0])
    out: list[Command] = [AddUser(m.UserSettings(name)) for name in names]
    for t, command in said:
        out += [command, Advance(t)]
    return out


@contextmanager
def searching() -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """A solver's process, and the one that searches for it."""
    command = [sys.executable, "-m", "synchronizar.live.estimating"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            said = commands()
            process.stdin.write(framed(Begin(1)) + framed(Block(1, said)))
            process.stdin.flush()
            for _ in (command for command in said if isinstance(command, Advance)):
                (size,) = LENGTH.unpack(process.stdout.read(LENGTH.size))
                assert isinstance(reply_decoder.decode(process.stdout.read(size)), Told)
            children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
            (child,) = children.read_text().split()
            yield process, int(child)
        finally:
            process.kill()
            process.stdin.close()


def comes_true(what: Callable[[], bool]) -> bool:
    until = time.monotonic() + 60.0
    while not what() and time.monotonic() < until:
        time.sleep(0.02)
    return what()


def is_running(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_search_ends_when_its_solver_is_killed() -> None:
    with searching() as (process, search):
        assert is_running(search)
        os.kill(process.pid, signal.SIGKILL)
        assert comes_true(lambda: not is_running(search))


def test_a_solver_and_its_search_end_when_their_server_is_gone() -> None:
    """While nothing is said, and while something that nobody hears any more is to be told."""
    for told in (False, True):
        with searching() as (process, search):
            assert process.stdin is not None
            assert process.stdout is not None
            if told:
                process.stdout.close()
                process.stdin.write(framed(Block(2, [Advance(10.0 + n) for n in range(100)])))
                process.stdin.flush()
            else:
                process.stdin.close()
            assert comes_true(lambda: not is_running(process.pid))
            assert comes_true(lambda: not is_running(search))
            assert process.wait() == 0
