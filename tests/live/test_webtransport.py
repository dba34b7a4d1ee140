"""A client by WebTransport, as a browser is one, on the loopback."""

from __future__ import annotations

import asyncio
import ssl
import struct
from hashlib import sha256
from typing import Any

import pytest

pytest.importorskip("aioquic", reason="the extra `webtransport` is not installed")

from aioquic.asyncio import QuicConnectionProtocol, connect
from aioquic.h3.connection import H3_ALPN, H3Connection
from aioquic.h3.events import DatagramReceived, HeadersReceived
from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.events import StreamDataReceived
from support.serving import run

from synchronizar.live import messages as m
from synchronizar.live.connection import serve_link
from synchronizar.live.lobby import Lobby
from synchronizar.live.pose_wire import (
    PoseDown,
    PosesDown,
    PoseUp,
    decode_poses_down,
    encode_poses_down,
    encode_poses_up,
    parts_of_poses,
)
from synchronizar.live.room import Room
from synchronizar.live.room_host import RoomClock
from synchronizar.live.solver_wire import Pose
from synchronizar.live.webtransport import LARGEST_DATAGRAM, WebTransportPort, _Link

NO_TURN = (0.0, 0.0, 0.0, 1.0)


class Browser(QuicConnectionProtocol):
    """As little of a browser's side as is needed."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.http = H3Connection(self._quic, enable_webtransport=True)
        self.words: asyncio.Queue[m.FromRoom] = asyncio.Queue()
        self.datagrams: asyncio.Queue[bytes] = asyncio.Queue()
        self.status: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        self.stream = -1
        self._bytes = bytearray()

    def quic_event_received(self, event: Any) -> None:
        if isinstance(event, StreamDataReceived) and event.stream_id == self.stream:
            self._take(event.data)  # aioquic's client would take what comes on its own stream for HTTP
            return
        for heard in self.http.handle_event(event):
            match heard:
                case HeadersReceived():
                    self.status.set_result(dict(heard.headers)[b":status"])
                case DatagramReceived():
                    self.datagrams.put_nowait(heard.data)

    def _take(self, data: bytes) -> None:
        self._bytes += data
        while len(self._bytes) >= 4 and len(self._bytes) >= 4 + (size := int.from_bytes(self._bytes[:4], "little")):
            self.words.put_nowait(m.decode_from_room(bytes(self._bytes[4 : 4 + size])))
            del self._bytes[: 4 + size]

    async def open(self, path: bytes, origin: bytes | None = None) -> tuple[int, bytes]:
        session = self._quic.get_next_available_stream_id()
        headers = [
            (b":method", b"CONNECT"),
            (b":scheme", b"https"),
            (b":authority", b"localhost"),
            (b":path", path),
            (b":protocol", b"webtransport"),
            *([] if origin is None else [(b"origin", origin)]),
        ]
        self.http.send_headers(session, headers)
        self.transmit()
        return session, await self.status

    def say(self, stream: int, message: Any) -> None:
        word = m.encode(message)
        self._quic.send_stream_data(stream, struct.pack("<I", len(word)) + word)
        self.transmit()


def test_words_and_poses_come_and_go_by_webtransport() -> None:
    lobby = Lobby(RoomClock())
    room = Room("CODE", RoomClock())
    fed: list[Any] = []

    class Solver:
        trouble: str | None = None

        def feed(self, command: Any) -> None:
            fed.append(command)

        def advance(self, t: float) -> None: ...

        def finish(self, t: float) -> None: ...

        async def drained(self) -> None: ...

    room.solver = Solver()
    lobby.add(room)

    async def test() -> None:
        port = await WebTransportPort.open("127.0.0.1", 0, lambda link: serve_link(link, lobby))
        configuration = QuicConfiguration(is_client=True, alpn_protocols=H3_ALPN, max_datagram_frame_size=65536)
        configuration.verify_mode = ssl.CERT_NONE
        async with connect("127.0.0.1", port.port, configuration=configuration, create_protocol=Browser) as browser:
            assert isinstance(browser, Browser)
            shown = browser._quic.tls._peer_certificate
            assert shown is not None
            session, status = await browser.open(b"/live")
            assert status == b"200"
            stream = browser.stream = browser.http.create_webtransport_stream(session)
            token = lobby.join(m.Join("CODE", [m.UserSettings("alice", up="y")]), "here").token
            browser.say(stream, m.Hello(token))
            welcome = await browser.words.get()
            assert isinstance(welcome, m.Welcome)
            browser.say(stream, m.Ping(1.0))
            while not isinstance(await browser.words.get(), m.Pong):
                pass
            pose = PoseUp(0, 0, 1, 1.5, (1.0, 2.0, 3.0), NO_TURN)
            while not any(isinstance(command, Pose) for command in fed):
                browser.http.send_datagram(session, encode_poses_up([pose]))
                browser.transmit()
                await asyncio.sleep(0.01)
            assert next(command for command in fed if isinstance(command, Pose)).position == (1.0, 2.0, 3.0)
            room.tick()
            poses = decode_poses_down(await browser.datagrams.get())
            assert poses.poses == []
        port.close()

    run(test)


def test_other_paths_are_not_served_and_the_hash_is_that_of_the_certificate() -> None:
    async def test() -> None:
        port = await WebTransportPort.open("127.0.0.1", 0, lambda link: link.close())
        configuration = QuicConfiguration(is_client=True, alpn_protocols=H3_ALPN, max_datagram_frame_size=65536)
        configuration.verify_mode = ssl.CERT_NONE
        async with connect("127.0.0.1", port.port, configuration=configuration, create_protocol=Browser) as browser:
            assert isinstance(browser, Browser)
            _, status = await browser.open(b"/elsewhere")
            assert status == b"404"
            from cryptography.hazmat.primitives.serialization import Encoding

            shown = browser._quic.tls._peer_certificate
            assert sha256(shown.public_bytes(Encoding.DER)).digest() == port.certificate_sha256
            assert (shown.not_valid_after_utc - shown.not_valid_before_utc).days < 14
        port.close()

    run(test)


def test_poses_of_many_are_cut_into_messages_that_fit() -> None:
    poses = [PoseDown(n, "registered", 0, 0.5, (float(n), 0.0, 0.0), NO_TURN) for n in range(64)]
    message = encode_poses_down(PosesDown(5, 2.5, poses))
    parts = [decode_poses_down(part) for part in parts_of_poses(message, LARGEST_DATAGRAM)]
    assert [pose for part in parts for pose in part.poses] == poses
    assert {(part.sequence, part.t) for part in parts} == {(5, 2.5)}
    assert max(map(len, parts_of_poses(message, LARGEST_DATAGRAM))) <= LARGEST_DATAGRAM


class Nobody:
    """In the place of a connection: takes nothing of what it is sent."""

    def __init__(self) -> None:
        self.sent = 0

    def send_words(self, stream: int, data: bytes) -> None:
        assert stream == 4
        self.sent += len(data)

    def unsent(self, stream: int) -> int:
        assert stream == 4
        return self.sent


def test_who_takes_nothing_is_sent_a_little_ahead_and_who_says_too_much_is_let_go() -> None:
    async def test() -> None:
        nobody = Nobody()
        link = _Link(nobody, 0, "10.0.0.66")  # type: ignore[arg-type]
        link.hear_words(4, struct.pack("<I", 2) + b"{}")
        sending = asyncio.create_task(send_all(link))
        await asyncio.sleep(0.1)
        assert nobody.sent < 400_000
        for _ in range(200):
            link.hear_words(4, struct.pack("<I", 60_000) + b"x" * 60_000)
            link.hear_datagram(b"x" * 1000)
        kept = [word async for word in link.received()]
        assert kept[0] == "{}"
        assert sum(map(len, kept)) < 3_000_000
        with pytest.raises(ConnectionError):
            await sending

    async def send_all(link: _Link) -> None:
        for _ in range(100):
            await link.send(b"x" * 60_000, True)

    run(test)


@pytest.mark.parametrize(("origin", "status"), [(b"https://evil.example", b"404"), (b"https://localhost:8443", b"200")])
def test_a_page_from_elsewhere_opens_no_session(origin: bytes, status: bytes) -> None:
    async def test() -> None:
        port = await WebTransportPort.open("127.0.0.1", 0, lambda link: link.close())
        configuration = QuicConfiguration(is_client=True, alpn_protocols=H3_ALPN, max_datagram_frame_size=65536)
        configuration.verify_mode = ssl.CERT_NONE
        async with connect("127.0.0.1", port.port, configuration=configuration, create_protocol=Browser) as browser:
            assert isinstance(browser, Browser)
            assert (await browser.open(b"/live", origin))[1] == status
        port.close()

    run(test)
