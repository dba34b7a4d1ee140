"""A server of one's own, and native devices that walk as a recording says while pages walk beside them."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from synchronizar.data.recording import Recording
from synchronizar.live.client import Client
from synchronizar.live.messages import MeasuredRange

_BEAT_S = 0.04


@contextmanager
def server(*options: str) -> Iterator[dict[str, Any]]:
    """A server on this machine alone: what it says of itself once it listens, and the number of its process."""
    words = ["serve", "--host", "127.0.0.1", "--port", "0", "--udp-port", "0", "--json", *options]
    process = subprocess.Popen([sys.executable, "-m", "synchronizar", *words], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield json.loads(process.stdout.readline()) | {"pid": process.pid}
    finally:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


async def walk(client: Client, recording: Recording, own: Iterable[str], began: float, heard: bool = False) -> None:
    """Say what the devices `own` of a recording see and measure, as it comes; its t = 0 is at `began` (s since 1970).

    Of the ranges those of them with one another and with others who are in the room. Goes on until it is cancelled.
    `heard`: somebody else hears what the client is told.
    """
    own = set(own)
    hearing = None if heard else asyncio.create_task(_hear(client))
    poses = sorted(
        ((t, name, position, quat) for name in own for t, position, quat in _poses(recording, name)),
        key=lambda pose: pose[0],
    )
    ranges = sorted(_ranges(recording, own), key=lambda measured: measured.t)
    try:
        while True:
            now = time.time() - began
            count = bisect_right(poses, now, key=lambda pose: pose[0])
            await client.send_poses([(name, began + t, xyz, quat) for t, name, xyz, quat in poses[:count]])
            del poses[:count]
            await _say_due(client, ranges, began)
            await asyncio.sleep(_BEAT_S)
    finally:
        if hearing is not None:
            hearing.cancel()


async def say_ranges(client: Client, ranges: Iterable[MeasuredRange], began: float) -> None:
    """Say ranges as they come, in the order of time; their t = 0 is at `began`. Until it is cancelled."""
    left = list(ranges)
    while True:
        await _say_due(client, left, began)
        await asyncio.sleep(_BEAT_S)


def ranges_between(recording: Recording, a: str, b: str) -> list[MeasuredRange]:
    """Those of two devices with one another, in the order of time."""
    return sorted((one for one in _ranges(recording, {a}) if {one.a, one.b} == {a, b}), key=lambda one: one.t)


async def _say_due(client: Client, left: list[MeasuredRange], began: float) -> None:
    """What is due of those that are left to say, to a room in which both are."""
    now = time.time() - began
    count = bisect_right(left, now, key=lambda measured: measured.t)
    known = [one for one in left[:count] if {one.a, one.b} <= client.members.keys()]
    if known:
        await client.send_ranges([_at(measured, began) for measured in known])
    del left[:count]


async def _hear(client: Client) -> None:
    async for _ in client.messages():
        pass


def _poses(recording: Recording, name: str) -> Iterator[tuple[float, list[float], list[float]]]:
    track = recording.tracks[name]
    yield from zip(track.t.tolist(), track.position.tolist(), track.quat_xyzw.tolist(), strict=True)


def _ranges(recording: Recording, own: set[str]) -> Iterator[MeasuredRange]:
    names, r = [user.name for user in recording.users], recording.ranges
    for t, a, b, distance in zip(r.t.tolist(), r.a.tolist(), r.b.tolist(), r.distance.tolist(), strict=True):
        if {names[a], names[b]} & own:
            yield MeasuredRange(t, names[a], names[b], distance)


def _at(measured: MeasuredRange, began: float) -> MeasuredRange:
    return MeasuredRange(began + measured.t, measured.a, measured.b, measured.distance)
