"""The bridge's connection to one rosbridge: called again when it breaks, looked at for new topics."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from synchronizar.convert.fields import Topic
from synchronizar.convert.takers import Decode
from synchronizar.errors import InputError
from synchronizar.ros import outgoing
from synchronizar.ros.ends import Ends
from synchronizar.ros.listening import HeardPose, HeardRange, Listening
from synchronizar.ros.options import BridgeOptions
from synchronizar.ros.robot import Robot
from synchronizar.ros.rosapi import Rosapi
from synchronizar.ros.rosbridge import Rosbridge, ServiceError

LOOKED_EVERY_S = 3.0
"""s between looks at what topics there are."""
AGAIN_S = 1.0
ROSAPI_WITHIN_S = 10.0
"""s in which rosapi has to have begun, where rosbridge has."""
POSES_EVERY_MS = 16
"""ms: of tracks that say more poses, rosbridge leaves some out."""


@dataclass
class Sampled:
    """What came in a while, as `listing` reads it."""

    topics: list[Topic]
    messages: Sequence[tuple[str, float, Any]]
    remedy: str = "a message of rosbridge"

    def read(self, names: Collection[str]) -> Iterator[tuple[str, float, Decode, float]]:
        """As `Messages.read`."""
        for topic, t, message in self.messages:
            if topic in names:
                yield topic, t, partial(_as_it_is, message), 1.0


def _as_it_is(message: Any) -> Any:
    return message


class Link:
    """One rosbridge."""

    def __init__(
        self,
        name: str | None,
        address: str,
        options: BridgeOptions,
        told: Callable[[str], None],
        clock: Callable[[], float],
    ) -> None:
        """`name`: whose all tracks there are, where it is one robot's own."""
        self.address = address
        asked = options.asked if name is None else replace(options.asked, user=name)
        self.listening = Listening(asked, options.said, address, options.common, told)
        self.ends = Ends(asked, options.said)
        self.held: deque[HeardRange] = deque()
        """Ranges whose ends are not in the room, of which `held_for` was known when all of them were looked at last."""
        self.held_for: tuple[frozenset[str], int] = frozenset(), 0
        self.unknown: Counter[str] = Counter()
        """Ranges that were left out, by the radio of which nobody knows whose it is."""
        self._told, self._clock = told, clock
        self._rosbridge: Rosbridge | None = None
        self._missing: set[str] = set()
        self._has_rosapi = False

    async def run(self, hear: Callable[[HeardPose | HeardRange], Awaitable[None]]) -> None:
        """Without end. Raises InputError where nobody answers at first, or a topic is not what was said."""
        ever, last = False, ""
        while True:
            try:
                rosbridge = await Rosbridge.connect(self.address, self._told)
            except InputError as error:
                if not ever:
                    raise
                if str(error) != last:
                    last = str(error)
                    self._told(f"{error}; it is tried again")
                await asyncio.sleep(AGAIN_S)
                continue
            if ever:
                self._told(f"{self.address}: rosbridge is there again")
            ever, last = True, ""
            self.listening.forget_subscriptions()
            await self._stay(rosbridge, hear)
            self._told(f"{self.address}: rosbridge has ended the connection; it is called again")
            await asyncio.sleep(AGAIN_S)

    async def publish(self, topic: str, kind: str, message: Mapping[str, Any]) -> None:
        """A message, where there is a connection."""
        if self._rosbridge is not None:
            with suppress(ConnectionError):
                await self._rosbridge.publish(topic, kind, message)

    def frame_of(self, robot: Robot, here: Sequence[Robot]) -> tuple[str, str]:
        """The frame of a robot's odometry, and the topic of its transforms; `here`: all robots of this rosbridge.

        The frame is the one of its messages; where two robots on one topic have the same, each has its name before it.
        """
        topic = self._tf_topic(robot)
        if robot.settings.frame is not None:
            return robot.settings.frame, topic
        frame = robot.frame_id or f"{robot.name}/odom"
        alike = [r for r in here if r.frame_id == robot.frame_id and self._tf_topic(r) == topic]
        return (f"{robot.name}/{frame}" if len(alike) > 1 and robot.frame_id else frame), topic

    async def sample(self, seconds: float) -> Sampled:
        """What comes in so many seconds. Raises InputError where nobody answers."""
        rosbridge = await Rosbridge.connect(self.address, self._told)
        messages: list[tuple[str, float, Any]] = []

        async def hear() -> None:
            async for topic, message in rosbridge.messages():
                messages.append((topic, self._clock(), message))

        hearing = asyncio.create_task(hear())
        try:
            topics = await self._topics(Rosapi(rosbridge))
            for wanted in self.listening.learn(topics):
                await rosbridge.subscribe(wanted.topic, wanted.kind)
            await asyncio.sleep(seconds)
        except ConnectionError as error:
            raise InputError(self.address, f"rosbridge has ended the connection: {error}") from error
        finally:
            hearing.cancel()
            await rosbridge.close()
        counts = Counter(topic for topic, _, _ in messages)
        return Sampled([replace(topic, count=counts[topic.name]) for topic in topics], messages)

    async def _stay(self, rosbridge: Rosbridge, hear: Callable[[HeardPose | HeardRange], Awaitable[None]]) -> None:
        """Until the connection ends."""
        self._rosbridge = rosbridge
        tasks = [asyncio.create_task(self._read(rosbridge, hear)), asyncio.create_task(self._look(rosbridge))]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                with suppress(ConnectionError):
                    task.result()
        finally:
            self._rosbridge = None
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            with suppress(ConnectionError):
                await rosbridge.close()

    async def _read(self, rosbridge: Rosbridge, hear: Callable[[HeardPose | HeardRange], Awaitable[None]]) -> None:
        async for topic, message in rosbridge.messages():
            for heard in self.listening.hear(topic, self._clock(), message):
                await hear(heard)
            while self.listening.dropped:
                await rosbridge.unsubscribe(self.listening.dropped.pop())

    async def _look(self, rosbridge: Rosbridge) -> None:
        """Subscribe to what there is, and again to what comes."""
        rosapi = Rosapi(rosbridge)
        while True:
            new = self.listening.learn(await self._topics(rosapi))
            # Rosbridge takes a topic's QoS when it subscribes, and may hear nothing of who publishes later by another.
            for silent in self.listening.silent():
                if silent not in new:
                    await rosbridge.unsubscribe(silent.topic)
                    new.append(silent)
            for wanted in new:
                await rosbridge.subscribe(wanted.topic, wanted.kind, POSES_EVERY_MS if wanted.is_track else 0)
            for name in set(self.listening.missing()) - self._missing:
                self._missing.add(name)
                self._told(f"{self.address}: there is no topic {name} yet: it is waited for")
            await asyncio.sleep(LOOKED_EVERY_S)

    async def _topics(self, rosapi: Rosapi) -> list[Topic]:
        """Raises InputError where rosapi has never begun; one that was there is waited for."""
        waited = 0.0
        while True:
            try:
                topics = await rosapi.topics()
            except ServiceError as error:
                if waited >= ROSAPI_WITHIN_S and not self._has_rosapi:
                    raise InputError(
                        self.address,
                        f"rosbridge answers, but rosapi does not ({error}): rosapi_node has to run beside it",
                    ) from error
            else:
                self._has_rosapi = True
                return topics
            await asyncio.sleep(AGAIN_S)
            waited += AGAIN_S

    def _tf_topic(self, robot: Robot) -> str:
        if robot.settings.tf is not None:
            return robot.settings.tf
        above = self.listening.users().get(robot.name, "")
        while (above := above.rpartition("/")[0]) != "":
            known = self.listening.topics.get(f"{above}/tf")
            if known is not None and known.type == outgoing.TF:
                return f"{above}/tf"
        return "/tf"
