"""Connections by WebTransport: words on one stream, poses as datagrams that nobody waits for. Needs aioquic.

The client opens one bidirectional stream and says its words there, each with its length (u32, little-endian) before it;
the room answers on the same stream. Datagrams are the same bytes as the binary messages of a WebSocket; the room sends
everybody's poses in as many messages as datagrams need.

Browsers take a certificate that nobody vouches for where its hash is known and it holds for two weeks at most: one is
made at each start, and its hash told at joining.
"""

from __future__ import annotations

import asyncio
import struct
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

from aioquic.asyncio.protocol import QuicConnectionProtocol
from aioquic.asyncio.server import QuicServer
from aioquic.asyncio.server import serve as serve_quic
from aioquic.h3.connection import H3_ALPN, H3Connection
from aioquic.h3.events import DatagramReceived, H3Event, HeadersReceived, WebTransportStreamDataReceived
from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.events import ConnectionTerminated, ProtocolNegotiated, QuicEvent, StreamReset

from synchronizar.errors import InputError
from synchronizar.live.certificates import make_certificate
from synchronizar.live.connection import Link
from synchronizar.live.messages import LARGEST_MESSAGE
from synchronizar.live.origin import is_own
from synchronizar.live.pose_wire import parts_of_poses

LARGEST_DATAGRAM = 1100
"""Bytes that fit into one packet on any network, beside what QUIC adds."""
_DAYS = 13
_LENGTH = struct.Struct("<I")
_MOST_WAITING, _MOST_BYTES_WAITING = 1000, 2 * 1024 * 1024
_MOST_UNSENT = 256 * 1024
"""Bytes of words that are sent ahead of what the other end has taken; more of them wait in the outbox."""
_LOOKED_EVERY_S = 0.02


class WebTransportPort:
    """Listens for WebTransport; `certificate_sha256` is what a browser has to be told."""

    def __init__(self, server: QuicServer, port: int, certificate_sha256: bytes) -> None:
        self.port, self.certificate_sha256 = port, certificate_sha256
        self._server = server

    @classmethod
    async def open(
        cls, host: str | None, port: int, serve: Callable[[Link], Awaitable[None]], public_url: str | None = None
    ) -> WebTransportPort:
        """`serve` is given each connection; pages may come from `public_url` besides.

        Raises InputError where the port cannot be listened at.
        """
        pem, der = make_certificate(_DAYS)
        configuration = QuicConfiguration(is_client=False, alpn_protocols=H3_ALPN, max_datagram_frame_size=65536)
        with tempfile.TemporaryDirectory(prefix="synchronizar-") as folder:
            path = Path(folder) / "certificate.pem"
            path.touch(mode=0o600)
            path.write_bytes(pem)
            configuration.load_cert_chain(path, path)
        try:
            server = await serve_quic(
                host or "0.0.0.0",
                port,
                configuration=configuration,
                create_protocol=lambda *args, **settings: _Protocol(
                    *args, serve=serve, public_url=public_url, **settings
                ),
            )
        except OSError as error:
            raise InputError("--port", f"UDP {port} cannot be listened at: {error.strerror}; choose another") from error
        transport: Any = server._transport
        return cls(server, int(transport.get_extra_info("sockname")[1]), sha256(der).digest())

    def close(self) -> None:
        """Listen no more."""
        self._server.close()


class _Link:
    """One session."""

    def __init__(self, protocol: _Protocol, session: int, address: str) -> None:
        self.address = address
        self._protocol, self._session = protocol, session
        self._stream: int | None = None
        self._bytes = bytearray()
        self._came: asyncio.Queue[str | bytes | None] = asyncio.Queue(_MOST_WAITING)
        self._waiting_bytes = 0
        self._ended = False

    async def received(self) -> AsyncIterator[str | bytes]:
        while (word := await self._came.get()) is not None:
            self._waiting_bytes -= len(word)
            yield word

    async def send(self, data: bytes, text: bool) -> None:
        if self._ended:
            raise ConnectionError("the session has ended")
        if not text:
            for part in parts_of_poses(data, LARGEST_DATAGRAM):
                self._protocol.send_datagram(self._session, part)
        elif self._stream is not None:
            while self._protocol.unsent(self._stream) > _MOST_UNSENT:
                await asyncio.sleep(_LOOKED_EVERY_S)
                if self._ended:
                    raise ConnectionError("the session has ended")
            self._protocol.send_words(self._stream, _LENGTH.pack(len(data)) + data)

    async def close(self) -> None:
        self.end()
        self._protocol.end_session(self._session)

    def end(self) -> None:
        """Nothing more comes."""
        self._ended = True
        if self._came.full():
            self._came.get_nowait()
        self._came.put_nowait(None)

    def hear_words(self, stream: int, data: bytes) -> None:
        """Bytes of a stream; the first one that the client opens is that of words, others are not heard."""
        if self._stream is None:
            self._stream = stream
        if stream != self._stream or self._ended:
            return
        self._bytes += data
        while len(self._bytes) >= _LENGTH.size:
            (size,) = _LENGTH.unpack_from(self._bytes)
            if size > LARGEST_MESSAGE:
                self.end()
                return
            if len(self._bytes) < _LENGTH.size + size:
                return
            word = bytes(self._bytes[_LENGTH.size : _LENGTH.size + size]).decode("utf-8", "replace")
            del self._bytes[: _LENGTH.size + size]
            if not self._take(word):
                self.end()  # words must not be lost: whoever says so many is let go
                return

    def hear_datagram(self, data: bytes) -> None:
        """A datagram; lost where too many wait, as on any network."""
        self._take(data)

    def _take(self, word: str | bytes) -> bool:
        """Have it wait; False where too much does."""
        if self._ended or self._came.full() or self._waiting_bytes > _MOST_BYTES_WAITING:
            return False
        self._waiting_bytes += len(word)
        self._came.put_nowait(word)
        return True


class _Protocol(QuicConnectionProtocol):
    """One connection, with a session or several."""

    def __init__(
        self, *args: Any, serve: Callable[[Link], Awaitable[None]], public_url: str | None, **settings: Any
    ) -> None:
        super().__init__(*args, **settings)
        self._serve, self._public_url = serve, public_url
        self._http: H3Connection | None = None
        self._links: dict[int, _Link] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    def quic_event_received(self, event: QuicEvent) -> None:
        if isinstance(event, ProtocolNegotiated):
            self._http = H3Connection(self._quic, enable_webtransport=True)
        if isinstance(event, ConnectionTerminated):
            for link in self._links.values():
                link.end()
        elif isinstance(event, StreamReset) and event.stream_id in self._links:
            self._links[event.stream_id].end()
        if self._http is not None:
            for heard in self._http.handle_event(event):
                self._hear(heard)

    def send_datagram(self, session: int, data: bytes) -> None:
        """A datagram of a session."""
        assert self._http is not None
        self._http.send_datagram(session, data)
        self.transmit()

    def send_words(self, stream: int, data: bytes) -> None:
        """Bytes on a stream."""
        self._quic.send_stream_data(stream, data)
        self.transmit()

    def unsent(self, stream: int) -> int:
        """Bytes on a stream that wait to be sent or to be acknowledged."""
        open_streams: dict[int, Any] = self._quic._streams
        return len(open_streams[stream].sender._buffer) if stream in open_streams else 0

    def end_session(self, session: int) -> None:
        """The other end sees that it has ended."""
        self._links.pop(session, None)
        with suppress(AssertionError, RuntimeError):
            self._quic.send_stream_data(session, b"", end_stream=True)
            self.transmit()

    def _hear(self, event: H3Event) -> None:
        match event:
            case HeadersReceived():
                self._request(event)
            case WebTransportStreamDataReceived():
                if (link := self._links.get(event.session_id)) is not None:
                    link.hear_words(event.stream_id, event.data)
            case DatagramReceived():
                if (link := self._links.get(event.stream_id)) is not None:
                    link.hear_datagram(event.data)

    def _request(self, event: HeadersReceived) -> None:
        assert self._http is not None
        headers = dict(event.headers)
        wanted = headers.get(b":method"), headers.get(b":protocol"), headers.get(b":path")
        origin = headers[b"origin"].decode("ascii", "replace") if b"origin" in headers else None
        host = headers.get(b":authority", b"").decode("ascii", "replace")
        found = wanted == (b"CONNECT", b"webtransport", b"/live") and is_own(origin, host, self._public_url, True)
        status = b"200" if found else b"404"
        answer = [(b":status", status), (b"sec-webtransport-http3-draft", b"draft02")]
        self._http.send_headers(event.stream_id, answer, end_stream=not found)
        self.transmit()
        if found:
            paths = self._quic._network_paths
            link = _Link(self, event.stream_id, str(paths[0].addr[0]) if paths else "")
            self._links[event.stream_id] = link
            task = asyncio.ensure_future(self._serve(link))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
