"""A stand-in for rosbridge and rosapi: what their protocol 2 says of topics and of the two services that are used.

Messages that are published are checked as rosbridge checks them: against the definitions that ROS 2 itself has.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

from aiohttp import WSMsgType, web

from support.bags import store_with

RANGING = "uwb_msgs/msg/RangeStamped"
DEFINITIONS = {RANGING: "std_msgs/Header header\nstring from_id\nstring to_id\nfloat64 distance_m\n"}
_ATOMS = {"float64": "double", "float32": "float", "bool": "boolean", "byte": "octet"}


@dataclass
class Subscription:
    kind: str
    throttle_s: float
    last: float = -1e9


@dataclass(eq=False)
class Caller:
    """A connection."""

    socket: web.WebSocketResponse
    subscriptions: dict[str, Subscription] = field(default_factory=dict)
    advertised: dict[str, str] = field(default_factory=dict)


class StandIn:
    """`topics`: by name, package/msg/Name; those that are advertised come to it."""

    def __init__(self, topics: dict[str, str], clock: Callable[[], float], with_rosapi: bool = True) -> None:
        """`clock`: by which messages are throttled."""
        self.topics, self.clock, self.with_rosapi = dict(topics), clock, with_rosapi
        self.callers: set[Caller] = set()
        self.heard: list[dict[str, Any]] = []
        """All words that came."""
        self.published: list[tuple[str, dict[str, Any]]] = []
        self.complaints: list[str] = []
        """Errors and warnings that it told."""
        self.unsubscribed: list[str] = []
        self._store = store_with(DEFINITIONS, 2)
        self._instances: dict[str, Any] = {}

    def of(self, topic: str) -> list[dict[str, Any]]:
        """What was published there."""
        return [message for name, message in self.published if name == topic]

    def subscribed(self) -> set[str]:
        return {topic for caller in self.callers for topic in caller.subscriptions}

    async def until_subscribed(self, *topics: str) -> None:
        while not set(topics) <= self.subscribed():
            await asyncio.sleep(0.005)

    async def say(self, topic: str, message: dict[str, Any]) -> None:
        """A robot publishes."""
        for caller in list(self.callers):
            subscription = caller.subscriptions.get(topic)
            if subscription is None or self.clock() - subscription.last < subscription.throttle_s:
                continue
            subscription.last = self.clock()
            await self.send(caller, json.dumps({"op": "publish", "topic": topic, "msg": message}))

    async def send(self, caller: Caller, text: str) -> None:
        with suppress(ConnectionError):
            await caller.socket.send_str(text)

    async def hang_up(self) -> None:
        for caller in list(self.callers):
            await caller.socket.close()

    async def serve(self, request: web.Request) -> web.WebSocketResponse:
        caller = Caller(web.WebSocketResponse())
        await caller.socket.prepare(request)
        self.callers.add(caller)
        try:
            async for word in caller.socket:
                assert word.type is WSMsgType.TEXT
                said = json.loads(word.data)
                self.heard.append(said)
                await self._hear(caller, said)
        finally:
            self.callers.discard(caller)
        return caller.socket

    async def _hear(self, caller: Caller, said: dict[str, Any]) -> None:
        match said["op"]:
            case "subscribe":
                await self._subscribe(caller, said)
            case "unsubscribe":
                self.unsubscribed.append(said["topic"])
                caller.subscriptions.pop(said["topic"], None)
            case "advertise":
                kind = _full(said["type"])
                if self.topics.setdefault(said["topic"], kind) != kind:
                    await self._complain(caller, "error", f"{said['topic']} is already {self.topics[said['topic']]}")
                else:
                    caller.advertised[said["topic"]] = kind
            case "publish":
                kind = caller.advertised.get(said["topic"])
                if kind is None:
                    await self._complain(caller, "error", f"{said['topic']} is not advertised")
                elif faults := list(self._faults(said["msg"], kind)):
                    await self._complain(caller, "error", f"{said['topic']}: {faults[0]}")
                else:
                    self.published.append((said["topic"], said["msg"]))
            case "call_service":
                await self._serve(caller, said)
            case "set_level":
                assert said["level"] in ("info", "warning", "error", "none")
            case op:
                await self._complain(caller, "error", f"Unknown operation: {op}")

    async def _subscribe(self, caller: Caller, said: dict[str, Any]) -> None:
        topic, kind = said["topic"], self.topics.get(said["topic"])
        if kind is None or _full(said.get("type", kind)) != kind:
            await self._complain(caller, "error", f"{topic} is {kind}, not {said.get('type')}")
            return
        assert said.get("compression", "none") == "none"
        caller.subscriptions[topic] = Subscription(kind, 1e-3 * said.get("throttle_rate", 0))

    async def _serve(self, caller: Caller, said: dict[str, Any]) -> None:
        answer: dict[str, Any] = {"op": "service_response", "id": said["id"], "service": said["service"]}
        if not self.with_rosapi:
            answer |= {"result": False, "values": f"Service {said['service']} does not exist"}
        elif said["service"] == "/rosapi/topics":
            names = list(self.topics)
            answer |= {"result": True, "values": {"topics": names, "types": [self.topics[name] for name in names]}}
        elif said["service"] == "/rosapi/message_details":
            answer |= {"result": True, "values": {"typedefs": self.typedefs(_full(said["args"]["type"]))}}
        await self.send(caller, json.dumps(answer))

    async def _complain(self, caller: Caller, level: str, text: str) -> None:
        self.complaints.append(text)
        await self.send(caller, json.dumps({"op": "status", "level": level, "msg": text}))

    def _fields(self, kind: str) -> list[tuple[str, str, int]]:
        """Name, type and length (-1: no list) of each field."""
        from rosbags.interfaces import Nodetype

        found = []
        for name, (node, of) in self._store.fielddefs[kind][1]:
            length = -1
            if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                length = of[1] if node is Nodetype.ARRAY else 0
                node, of = of[0]
            found.append((name, of[0] if node is Nodetype.BASE else of, length))
        return found

    def typedefs(self, kind: str) -> list[dict[str, Any]]:
        """What rosapi says of a type and of all in it."""
        return self._typedefs(kind, [])

    def _typedefs(self, kind: str, seen: list[str]) -> list[dict[str, Any]]:
        """As rosapi has them: short names, IDL's names of numbers, times as types of their own."""
        if kind in seen or kind not in self._store.fielddefs:
            return []
        seen.append(kind)
        fields = self._fields(kind)
        own = {
            "type": kind.replace("/msg/", "/"),
            "fieldnames": [name for name, _, _ in fields],
            "fieldtypes": [_ATOMS.get(of, of.replace("/msg/", "/")) for _, of, _ in fields],
            "fieldarraylen": [length for _, _, length in fields],
            "examples": ["" for _ in fields],
            "constnames": [],
            "constvalues": [],
        }
        return [own, *(of for _, inner, _ in fields for of in self._typedefs(inner, seen))]

    def _faults(self, message: Any, kind: str) -> list[str]:
        """What rosbridge would refuse: fields that the type has not, values of another kind."""
        if not isinstance(message, dict):
            return [f"{kind} is no {type(message).__name__}"]
        fields = {name: (of, length) for name, of, length in self._fields(kind)}
        found = [f"{kind} has no {name}" for name in message.keys() - fields.keys()]
        for name, value in message.items():
            if name not in fields:
                continue
            of, length = fields[name]
            if length > 0 and len(value) != length:
                found.append(f"{kind}.{name} has {length} items")
            for one in value if length >= 0 else [value]:
                found += self._faults(one, of) if "/" in of else _wrong(f"{kind}.{name}", one, of)
        return found


def _wrong(where: str, value: Any, of: str) -> list[str]:
    right = {"string": str, "bool": bool}.get(of, (int, float) if of.startswith("float") else int)
    good = isinstance(value, right) and (right is bool or not isinstance(value, bool))
    return [] if good else [f"{where} is {of}, not {value!r}"]


def _full(kind: str) -> str:
    return kind if kind.count("/") > 1 else kind.replace("/", "/msg/", 1)


@asynccontextmanager
async def standing_in(stand_in: StandIn, port: int = 0) -> AsyncIterator[str]:
    """Its address."""
    app = web.Application()
    app.router.add_get("/", stand_in.serve)
    runner = web.AppRunner(app, shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", port).start()
    try:
        yield f"ws://127.0.0.1:{runner.addresses[0][1]}"
    finally:
        await stand_in.hang_up()
        await runner.cleanup()


def stamp(t: float) -> dict[str, int]:
    sec, nanosec = divmod(round(1e9 * t), 10**9)
    return {"sec": sec, "nanosec": nanosec}


def header(t: float, frame_id: str) -> dict[str, Any]:
    return {"stamp": stamp(t), "frame_id": frame_id}


def pose(position: Any, quat_xyzw: Any) -> dict[str, Any]:
    return {
        "position": dict(zip("xyz", map(float, position), strict=True)),
        "orientation": dict(zip("xyzw", map(float, quat_xyzw), strict=True)),
    }


def odometry(t: float, frame_id: str, position: Any, quat_xyzw: Any) -> dict[str, Any]:
    told = {"pose": pose(position, quat_xyzw), "covariance": [0.0] * 36}
    return {"header": header(t, frame_id), "child_frame_id": "base_link", "pose": told}


def ranging(t: float, a: str, b: str, distance: float) -> dict[str, Any]:
    return {"header": header(t, "uwb"), "from_id": a, "to_id": b, "distance_m": distance}
