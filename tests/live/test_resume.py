"""A server that is killed, and another one that goes on with its rooms."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.serving import run

from synchronizar.data.recording import Recording
from synchronizar.errors import InputError
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.object_file import ObjectFile
from synchronizar.live.recorder import FolderRecorder, recorded_name
from synchronizar.live.resuming import begin_again, tail
from synchronizar.live.roster import KnownDevice
from synchronizar.live.solver_wire import AddUser, Advance, NewFrame, Pose, Range

NO_TURN = (0.0, 0.0, 0.0, 1.0)


@contextmanager
def server(*options: str) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    command = [
        sys.executable,
        "-m",
        "synchronizar",
        "serve",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
        "--no-tls",
        "--json",
    ]
    with subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, json.loads(process.stdout.readline())
        finally:
            process.kill()


def lines(files: Iterable[Path]) -> int:
    """Of the file that has the fewest."""
    return min((file.read_bytes().count(b"\n") for file in files), default=0)


def test_a_server_that_is_killed_loses_nothing_that_was_written_and_the_next_one_goes_on(tmp_path: Path) -> None:
    """Objects, devices, secrets, and all that was on disk."""
    resume: dict[str, str] = {}

    def written() -> int:
        """Poses of each device on disk."""
        files = list(tmp_path.glob("*/tracks/*.tum"))
        return lines(files) if len(files) == 2 else 0

    async def walk(where: dict[str, Any], count: int) -> None:
        """Until so many poses of each are on disk."""
        async with (
            await Client.join(where["join"], ["alice"], resume=resume.get("alice")) as alice,
            await Client.join(where["join"], {"bob~": {"up": "y"}}, resume=resume.get("bob~")) as bob,
        ):
            resume.update({"alice": alice.resume, "bob~": bob.resume})
            if "coin" not in alice.objects:
                await alice.say_message(m.Create("coin", "coin", (1.0, 2.0, 0.5), data={"worth": 3}))
            while written() < count:
                now = time.time()
                await alice.send_pose("alice", now, [now % 10.0, 0.0, 0.0], NO_TURN)
                await bob.send_pose("bob~", now, [0.0, 0.0, now % 10.0], NO_TURN)
                await alice.send_range(now, "alice", "bob~", 3.0)
                await asyncio.sleep(0.05)

    with server("--record", str(tmp_path)) as (process, first):
        run(lambda: walk(first, 40))
        (folder,) = tmp_path.iterdir()
        before = written(), lines([folder / "ranges.csv"]) - 1
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    recorded = Recording.load(folder)
    assert min(map(len, recorded.tracks.values())) >= before[0]
    assert len(recorded.ranges) >= before[1] > 0
    with server("--record", str(tmp_path), "--resume") as (process, second):
        assert second["room"] == first["room"]
        with pytest.raises(InputError, match="somebody called 'alice' already"):
            asyncio.run(Client.join(second["join"], ["alice"]))
        run(lambda: walk(second, before[0] + 40))
        process.send_signal(signal.SIGTERM)
        assert process.wait() == 0
    recorded = Recording.load(folder)
    assert min(map(len, recorded.tracks.values())) >= before[0] + 40
    assert {user.name: user.up for user in recorded.users} == {"alice": "z", "bob~": "y"}
    text = "".join(file.read_text() for file in folder.rglob("*") if file.suffix in (".json", ".toml", ".csv", ".tum"))
    assert first["room"] not in text
    assert not [secret for secret in resume.values() if secret in text]


def test_objects_come_back_as_they_were_written(tmp_path: Path) -> None:
    path = tmp_path / "objects.sqlite3"
    kept = ObjectFile(path)
    coin = m.Object("coin", "coin", (1.0, 2.0, 0.5), NO_TURN, "alice", data={"worth": 3})
    kept.save(coin)
    kept.save(m.Object("gone", "coin", (0.0, 0.0, 0.0), NO_TURN, "alice"))
    kept.flush()
    kept.save("gone")
    kept.flush()
    kept.save(m.Object("lost", "coin", (0.0, 0.0, 0.0), NO_TURN, "alice"))  # never flushed: its process was killed
    assert ObjectFile(path).load() == [coin]
    path.write_bytes(b"nonsense" * 100)
    with pytest.raises(InputError, match=r"objects\.sqlite3"):
        ObjectFile(path)
    assert sqlite3.sqlite_version


def test_what_came_after_the_state_is_said_again_in_the_order_of_time_and_half_a_line_is_not(tmp_path: Path) -> None:
    recorder = FolderRecorder(tmp_path)
    alice, bob = m.UserSettings("alice"), m.UserSettings("bob", antennas={"left": (0.1, 0.0, 0.0)})
    for user in (alice, bob):
        recorder.user(user, 0)
    recorder.range(0.5, "alice", "bob", (0, 0), 2.5, {})  # neither has a pose yet: no recording can have it
    recorder.pose("alice", 0, 1.0, (1.0, 2.0, 3.0), NO_TURN)
    recorder.pose("bob", 0, 1.0, (8.0, 8.0, 8.0), NO_TURN)
    recorder.range(1.0, "alice", "bob", (0, 0), 2.5, {"antenna_b": "left", "nlos": 1.0})
    before = recorder.offsets()
    recorder.user(bob, 1)
    recorder.pose("bob", 0, 1.2, (9.0, 9.0, 9.0), NO_TURN)  # of a frame that ended
    recorder.pose("bob", 1, 2.0, (4.0, 5.0, 6.0), NO_TURN)
    recorder.range(2.02, "alice", "bob", (0, 1), 3.5, {"antenna_b": "left", "sigma": 0.05, "source": "module"})
    recorder.pose("alice", 0, 2.01, (1.5, 2.0, 3.0), NO_TURN)
    recorder.note("resume.json", {"offsets": before, "frames": {}})
    (tmp_path / "solver.state").write_bytes(b"state")
    recorder.flush()
    with (tmp_path / "tracks" / "alice.tum").open("a") as file:
        file.write("2.5 1.0 2")
    begin, offsets = begin_again(tmp_path, 0, recorder.offsets())
    assert begin.state == str(tmp_path / "solver.state")
    assert offsets == before
    known = [KnownDevice(alice, "", 0, 0), KnownDevice(bob, "", 1, 1)]
    assert [c for c in tail(tmp_path, known, begin, offsets) if not isinstance(c, Advance)] == [
        AddUser(alice),
        AddUser(bob),
        NewFrame("bob", 1),
        Pose("bob", 2.0, (4.0, 5.0, 6.0), NO_TURN),
        Pose("alice", 2.01, (1.5, 2.0, 3.0), NO_TURN),
        Range(2.02, "alice", "bob", 3.5, {"antenna_b": "left", "sigma": 0.05, "source": "module"}),
    ]
    again = FolderRecorder(tmp_path)
    again.pose("alice", 0, 3.0, (1.0, 2.0, 3.0), NO_TURN)
    again.close()
    recorded = Recording.load(tmp_path)
    assert recorded.tracks["alice"].t.tolist() == [1.0, 2.01, 3.0]
    assert recorded_name("bob", 1) in recorded.tracks
    assert recorded.ranges.t.tolist() == [1.0, 2.02]


def test_a_state_that_knows_more_than_was_written_is_told_what_is_written_from_then_on(tmp_path: Path) -> None:
    recorder = FolderRecorder(tmp_path)
    alice = m.UserSettings("alice")
    recorder.user(alice, 0)
    recorder.pose("alice", 0, 1.0, (1.0, 2.0, 3.0), NO_TURN)
    recorder.flush()
    recorder.pose("alice", 0, 2.0, (1.0, 2.0, 3.0), NO_TURN)
    recorder.note("resume.json", {"offsets": recorder.offsets(), "frames": {}})
    (tmp_path / "solver.state").write_bytes(b"state")
    again = FolderRecorder(tmp_path)  # the other one's process was killed: its last line is lost
    begin, offsets = begin_again(tmp_path, 0, again.offsets())
    again.pose("alice", 0, 12.0, (4.0, 5.0, 6.0), NO_TURN)
    again.close()
    said = tail(tmp_path, [KnownDevice(alice, "", 0, 0)], begin, offsets)
    assert [c for c in said if isinstance(c, Pose)] == [Pose("alice", 12.0, (4.0, 5.0, 6.0), NO_TURN)]
