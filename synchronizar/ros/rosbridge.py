"""A client of rosbridge's WebSocket, protocol 2: topics and services of ROS as JSON."""

from __future__ import annotations

import asyncio
import json
import sys
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any

import aiohttp

from synchronizar.errors import InputError

_HEARTBEAT_S = 5.0
_ANSWERED_WITHIN_S = 5.0


def print_told(sentence: str) -> None:
    """To standard error."""
    print(f"synchronizar: {sentence}", file=sys.stderr, flush=True)


class ServiceError(Exception):
    """A service that does not answer, or says that it could not."""


class Rosbridge:
    """One connection. What comes is heard by `messages`, which has to be read all the time, for answers come by it."""

    def __init__(
        self,
        address: str,
        session: aiohttp.ClientSession,
        socket: aiohttp.ClientWebSocketResponse,
        told: Callable[[str], None],
    ) -> None:
        self.address = address
        self.malformed: Counter[str] = Counter()
        """What came and was left alone, by what it was."""
        self._session, self._socket, self._told = session, socket, told
        self._advertised: set[str] = set()
        self._calls: dict[str, asyncio.Future[Any]] = {}
        self._called = 0

    @classmethod
    async def connect(cls, address: str, told: Callable[[str], None] = print_told) -> Rosbridge:
        """`address`: ws://robot:9090. `told` hears what rosbridge complains of.

        Raises InputError where nobody answers there.
        """
        session = aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=None, connect=10.0))
        try:
            socket = await session.ws_connect(address, heartbeat=_HEARTBEAT_S)
            await socket.send_json({"op": "set_level", "level": "warning"})
        except (aiohttp.ClientError, OSError, ValueError) as error:
            await session.close()
            raise InputError(address, f"no rosbridge answers: {error}") from error
        except BaseException:
            await session.close()
            raise
        return cls(address, session, socket, told)

    async def close(self) -> None:
        """End the connection: rosbridge ends its subscriptions by itself."""
        await self._socket.close()
        await self._session.close()

    async def subscribe(self, topic: str, kind: str, every_ms: int = 0) -> None:
        """`every_ms`: what comes sooner after another message is left out by rosbridge; 0: all come."""
        asked = {"op": "subscribe", "id": topic, "topic": topic, "type": kind}
        await self._say(asked | {"throttle_rate": every_ms, "compression": "none"})

    async def unsubscribe(self, topic: str) -> None:
        """Nothing more of it."""
        await self._say({"op": "unsubscribe", "id": topic, "topic": topic})

    async def advertise(self, topic: str, kind: str) -> None:
        """Something will be said there: who hears of it early misses nothing."""
        if topic not in self._advertised:
            self._advertised.add(topic)
            await self._say({"op": "advertise", "id": topic, "topic": topic, "type": kind})

    async def publish(self, topic: str, kind: str, message: Mapping[str, Any]) -> None:
        """Say a message; the topic is advertised before the first one."""
        await self.advertise(topic, kind)
        await self._say({"op": "publish", "topic": topic, "msg": message})

    async def call(self, service: str, arguments: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        """What a service answers. Raises ServiceError, ConnectionError."""
        self._called += 1
        name = f"call_{self._called}"
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._calls[name] = answer
        try:
            await self._say({"op": "call_service", "id": name, "service": service, "args": dict(arguments or {})})
            return await asyncio.wait_for(answer, _ANSWERED_WITHIN_S)
        except TimeoutError:
            raise ServiceError(f"{service} does not answer") from None
        finally:
            del self._calls[name]

    async def messages(self) -> AsyncIterator[tuple[str, Any]]:
        """Topics and messages as they come, until the connection ends."""
        try:
            async for word in self._socket:
                if word.type is not aiohttp.WSMsgType.TEXT:
                    self.malformed["binary"] += 1
                elif (heard := self._understood(word.data)) is not None:
                    yield heard
        finally:
            for answer in self._calls.values():
                if not answer.done():
                    answer.set_exception(ConnectionError("rosbridge has ended the connection"))

    def _understood(self, data: str) -> tuple[str, Any] | None:
        """A topic's message; anything else is dealt with here."""
        try:
            word = json.loads(data)  # takes NaN, which older ones write
        except (ValueError, RecursionError):
            self.malformed["no JSON"] += 1
            return None
        op = word.get("op") if isinstance(word, dict) else None
        if op == "publish" and isinstance(word.get("topic"), str) and isinstance(word.get("msg"), dict):
            return word["topic"], word["msg"]
        if op == "service_response":
            self._answered(word)
        elif op == "status":
            self._told(f"{self.address}: rosbridge says {word.get('level')}: {' '.join(str(word.get('msg')).split())}")
        else:
            self.malformed[str(op)[:40]] += 1
        return None

    def _answered(self, word: Mapping[str, Any]) -> None:
        answer = self._calls.get(str(word.get("id")))
        if answer is None or answer.done():
            return
        values = word.get("values")
        if word.get("result", True) and isinstance(values, dict):
            answer.set_result(values)
        else:
            answer.set_exception(ServiceError(f"{word.get('service')}: {values}"))

    async def _say(self, word: Mapping[str, Any]) -> None:
        """Raises ConnectionError where rosbridge has gone."""
        try:
            await self._socket.send_str(json.dumps(word, allow_nan=False))
        except aiohttp.ClientError as error:
            raise ConnectionError(str(error)) from error
