"""`Client` for programs without asyncio: the same client, in a thread of its own."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Coroutine, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Literal, TypeVar

import msgspec

from synchronizar.live import messages as m
from synchronizar.live.client import Client
from synchronizar.live.pose_wire import PosesDown

_T = TypeVar("_T")
_Wanted = tuple[Callable[[m.FromRoom | PosesDown], bool], asyncio.Future[m.FromRoom | PosesDown]]
_LATEST_ONLY = (m.Frames, m.Status, m.Pong, PosesDown)
MOST_WAITING = 10_000
"""Messages that are kept until `messages` is asked for them; older ones are dropped."""


class BlockingClient:
    """One connection to a room, for one device or several, or for none, which only looks. Any thread may use it.

    `with BlockingClient.join("https://192.168.1.5:47180/#ABCD2345", ["alice"], up="y") as client: ...`
    """

    def __init__(self, client: Client, loop: asyncio.AbstractEventLoop, thread: threading.Thread) -> None:
        self._client, self._loop, self._thread = client, loop, thread
        self._waiting: deque[m.FromRoom] = deque(maxlen=MOST_WAITING)
        self._wanted: list[_Wanted] = []
        self._heard = threading.Condition()
        self._ended = False
        self._reading = asyncio.run_coroutine_threadsafe(self._read(), loop)

    @classmethod
    def join(
        cls,
        address: str,
        users: Iterable[str] | Mapping[str, Mapping[str, Any]] = (),
        *,
        up: Literal["y", "z"] = "z",
        time: Literal["live", "recorded"] = "live",
        resume: str | None = None,
        clock: Callable[[], float] = time.time,
    ) -> BlockingClient:
        """Join the room at an address; all arguments are those of `Client.join`."""
        loop = asyncio.new_event_loop()
        thread = threading.Thread(target=_run, args=(loop,), name="synchronizar client", daemon=True)
        thread.start()
        joining = Client.join(address, users, up=up, time=time, resume=resume, clock=clock)
        try:
            return cls(asyncio.run_coroutine_threadsafe(joining, loop).result(), loop, thread)
        except BaseException:
            _stop(loop, thread)
            raise

    def __enter__(self) -> BlockingClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def welcome(self) -> m.Welcome:
        """The room as it was at the beginning."""
        return self._client.welcome

    @property
    def resume(self) -> str:
        """To join again as the same devices."""
        return self._client.resume

    @property
    def frames(self) -> m.Frames:
        """Everybody's frames, as told last."""
        return self._client.frames

    @property
    def poses(self) -> PosesDown | None:
        """Everybody's poses in the common frame, as told last."""
        return self._client.poses

    @property
    def members(self) -> dict[str, m.Member]:
        """The devices of the room by name."""
        return self._client.members

    @property
    def objects(self) -> dict[str, m.Object]:
        """The objects of the room by id; a copy."""
        return dict(self._client.objects)

    @property
    def status(self) -> m.Status | None:
        """How the room is, as told last."""
        return self._client.status

    @property
    def refused(self) -> dict[str, str]:
        """What the room refused, by reason: the last sentence; a copy."""
        return dict(self._client.refused)

    @property
    def not_understood(self) -> dict[str, int]:
        """How many messages of the room were left alone because this client does not know them, by type; a copy."""
        return dict(self._client.not_understood)

    @property
    def offset(self) -> float | None:
        """s: the room's clock minus this client's."""
        return self._client.offset

    @property
    def ended(self) -> bool:
        """Whether the room, the network or this client has ended the connection."""
        return self._ended

    def send_pose(self, user: str, t: float, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
        """A device's pose in its own axes: s by the client's clock, (3,) m, (4,) x y z w."""
        self._do(self._client.send_pose(user, t, position, quat_xyzw))

    def send_poses(self, poses: Iterable[tuple[str, float, Sequence[float], Sequence[float]]]) -> None:
        """Several at once: user, t, position, quat_xyzw."""
        self._do(self._client.send_poses(poses))

    def send_range(self, t: float, a: str, b: str, distance: float, **columns: Any) -> None:
        """A distance (m) at t (s by the client's clock); other columns of ranges.csv by their names."""
        self._do(self._client.send_range(t, a, b, distance, **columns))

    def send_ranges(self, ranges: Sequence[m.MeasuredRange]) -> None:
        """Several at once."""
        self._do(self._client.send_ranges(ranges))

    def new_frame(self, user: str) -> None:
        """SLAM of a device began anew: its poses are in another frame from now on."""
        self._do(self._client.new_frame(user))

    def lost_tracking(self, user: str) -> None:
        """SLAM of a device has lost track."""
        self._do(self._client.lost_tracking(user))

    def say_message(self, message: msgspec.Struct) -> None:
        """Any message of `messages` that a client may say."""
        self._do(self._client.say_message(message))

    def messages(self, timeout: float | None = None) -> Iterator[m.FromRoom]:
        """What the room tells once (events, members, objects, what others say), in order, from the beginning.

        Ends with the connection, or when nothing has come for `timeout` seconds; it can be asked again. `frames`,
        `poses` and `status`, of which only the latest counts, are no part of it.
        """
        while True:
            with self._heard:
                if not self._heard.wait_for(lambda: self._waiting or self._ended, timeout) or not self._waiting:
                    return
                message = self._waiting.popleft()
            yield message

    def until(
        self, wanted: Callable[[m.FromRoom | PosesDown], bool], timeout: float | None = None
    ) -> m.FromRoom | PosesDown:
        """The first message of that kind that comes, of whatever type, or that waits for `messages`: it is taken there.

        Raises TimeoutError after `timeout` seconds without, ConnectionError where none comes any more.
        """
        return self._do(self._next(wanted, timeout))

    def close(self) -> None:
        """End the connection; the devices may come again with `resume`."""
        self._end(self._client.close)

    def leave(self) -> None:
        """Leave for good."""
        self._end(self._client.leave)

    def _do(self, what: Coroutine[Any, Any, _T]) -> _T:
        if self._ended or not self._thread.is_alive():
            what.close()
            raise ConnectionError("the connection to the room has ended")
        return asyncio.run_coroutine_threadsafe(what, self._loop).result()

    def _end(self, how: Callable[[], Coroutine[Any, Any, None]]) -> None:
        if not self._thread.is_alive():
            return
        with suppress(ConnectionError):
            asyncio.run_coroutine_threadsafe(how(), self._loop).result()
        self._reading.result()
        _stop(self._loop, self._thread)

    async def _next(
        self, wanted: Callable[[m.FromRoom | PosesDown], bool], timeout: float | None
    ) -> m.FromRoom | PosesDown:
        # An answer may have come before it is waited for.
        with self._heard:
            told = list(self._waiting)
        for message in told:
            if wanted(message):
                with self._heard, suppress(ValueError):  # somebody else has taken it in the meantime
                    self._waiting.remove(message)
                return message
        if self._ended:
            raise ConnectionError("the room has ended the connection")
        waiting: _Wanted = (wanted, self._loop.create_future())
        self._wanted.append(waiting)
        try:
            return await asyncio.wait_for(waiting[1], timeout)
        finally:
            self._wanted.remove(waiting)

    async def _read(self) -> None:
        failure: Exception = ConnectionError("the room has ended the connection")
        try:
            async for message in self._client.messages():
                self._hand_on(message)
        except Exception as error:  # whoever waits hears of it, and nobody else would
            failure = error
        with self._heard:
            self._ended = True
            self._heard.notify_all()
        for _, future in self._wanted:
            if not future.done():
                future.set_exception(failure)

    def _hand_on(self, message: m.FromRoom | PosesDown) -> None:
        taken = False
        for wanted, future in self._wanted:
            if future.done():
                continue
            try:
                if wanted(message):
                    future.set_result(message)
                    taken = True
            except Exception as error:  # it is the caller's, not the connection's
                future.set_exception(error)
        if not taken and not isinstance(message, _LATEST_ONLY):
            with self._heard:
                self._waiting.append(message)
                self._heard.notify_all()


def _run(loop: asyncio.AbstractEventLoop) -> None:
    asyncio.set_event_loop(loop)
    loop.run_forever()
    left = asyncio.all_tasks(loop)
    for task in left:
        task.cancel()
    loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
    loop.close()


def _stop(loop: asyncio.AbstractEventLoop, thread: threading.Thread) -> None:
    loop.call_soon_threadsafe(loop.stop)
    thread.join()
