"""`synchronizar play`: the devices of a recording join a room as if they were there."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from math import isfinite
from typing import Any

from synchronizar.data.in_time import A_SECOND, in_time
from synchronizar.data.ranges import SOURCES, Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.user import User
from synchronizar.geometry import YawFrame
from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.pose_wire import PosesDown
from synchronizar.live.words_file import Word

_KNOWN = ("static", "up", "height_sigma", "position", "position_sigma", "range_bias", "range_bias_sigma")


async def play(
    recording: Recording,
    address: str,
    speed: float = 1.0,
    told: Callable[[m.Frames], None] | None = None,
    words: Iterable[Word] = (),
) -> dict[str, Any]:
    """Play at `speed` times the speed at which it was recorded; the room's answer, a registration.json object.

    `words`: what was said and moved in the recorded room, which comes again at its moments and changes no answer.

    The room goes by the recording's time, and so its answer does not depend on the speed. Raises InputError where the
    room cannot be joined, ConnectionError where it ends before the answer.
    """
    users = {user.name: _settings(user) for user in recording.users}
    async with await Client.join(address, users, time="recorded") as client:
        saying = asyncio.create_task(_say(client, recording, speed, words))
        try:
            async for message in _until_ended(client, saying):
                if isinstance(message, m.Answer):
                    return message.registration
                if isinstance(message, m.Frames) and told is not None:
                    told(message)
        finally:
            saying.cancel()
    raise ConnectionError("the room ended before it answered")


async def _until_ended(client: Client, saying: asyncio.Task[None]) -> AsyncIterator[m.FromRoom | PosesDown]:
    async for message in client.messages():
        if saying.done() and (error := saying.exception()) is not None:
            raise error
        yield message


async def _say(client: Client, recording: Recording, speed: float, words: Iterable[Word]) -> None:
    """Everything in the order of time, a tenth of a second at once, and what time it is after each."""
    loop = asyncio.get_running_loop()
    began, first = loop.time(), None
    t, waiting = 0.0, deque(words)
    for last, t, poses, ranges in _ticks(recording):
        first = t if first is None else first
        if (early := began + (t - first) / speed - loop.time()) > 0.0:
            await asyncio.sleep(early)
        for at in range(0, len(poses), 128):
            await client.send_poses(poses[at : at + 128])
        if ranges:
            await client.send_ranges(ranges)
        while waiting and (last or waiting[0].t <= t):
            if (again := _again(waiting.popleft())) is not None:
                await client.say_message(again)
        if not last:
            await client.say_message(m.Clock(t))
    await client.say_message(m.Finish(t))


def _again(word: Word) -> m.Again | None:
    """What the room is told of a word; None of what was said to one alone."""
    if word.object is not None or word.removed is not None:
        return m.Again(object=word.object, removed=word.removed)
    return m.Again(said=word.said) if word.said is not None and word.to is None else None


_Poses = list[tuple[str, float, Any, Any]]


def _ticks(recording: Recording) -> Iterator[tuple[bool, float, _Poses, list[m.MeasuredRange]]]:
    """Whether it is the last, and what came in each tenth of a second in which a range came, and until then."""
    own = {user.name: _own(recording, user) for user in recording.users if not user.static}
    poses: _Poses = []
    ranges: list[m.MeasuredRange] = []
    tick: float | None = None
    last = 0.0
    for t, user, row in in_time(recording):
        if tick is not None and t >= (tick + 1) / A_SECOND:
            yield False, (tick + 1) / A_SECOND, poses, ranges
            tick, poses, ranges = None, [], []
        if user < 0:
            if isfinite(recording.ranges.distance[row]):  # JSON has no other numbers, and no solver uses them
                ranges.append(_range(recording.ranges, recording.users, row))
            tick = t * A_SECOND // 1
        else:
            name = recording.users[user].name
            position, quat = own[name]
            poses.append((name, t, position[row], quat[row]))
        last = t
    yield True, (last if tick is None else (tick + 1) / A_SECOND), poses, ranges


def _own(recording: Recording, user: User) -> tuple[Any, Any]:
    """Positions and attitudes in the device's own axes, as it says them."""
    track, own_from_z_up = recording.tracks[user.name], YawFrame(up_a=user.up)
    return (own_from_z_up @ track.position).tolist(), own_from_z_up.rotate_quaternions(track.quat_xyzw).tolist()


def _range(ranges: Ranges, users: tuple[User, ...], row: int) -> m.MeasuredRange:
    a, b = users[ranges.a[row]], users[ranges.b[row]]
    nlos, source = _number(ranges.nlos[row]), int(ranges.source[row])
    return m.MeasuredRange(
        t=float(ranges.t[row]),
        a=a.name,
        b=b.name,
        distance=float(ranges.distance[row]),
        sigma=_number(ranges.sigma[row]),
        antenna_a=_antenna(a, int(ranges.antenna_a[row])),
        antenna_b=_antenna(b, int(ranges.antenna_b[row])),
        rx_power=_number(ranges.rx_power[row]),
        fp_power=_number(ranges.fp_power[row]),
        nlos=None if nlos is None else nlos == 1.0,
        source=None if source < 0 else SOURCES[source],
    )


def _number(value: Any) -> float | None:
    return None if value != value else float(value)


def _antenna(user: User, which: int) -> str | None:
    return None if which < 0 else list(user.antennas)[which]


def _settings(user: User) -> dict[str, Any]:
    known = {name: getattr(user, name) for name in _KNOWN}
    return {**known, "antennas": dict(user.antennas)}
