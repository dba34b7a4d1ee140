"""The web side: pages, joining, and connections by WebSocket."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
from aiohttp import WSMsgType, web

from synchronizar.errors import InputError
from synchronizar.live import messages as m
from synchronizar.live.applications import loaded, pages_of
from synchronizar.live.connection import serve_link
from synchronizar.live.lobby import Lobby
from synchronizar.live.messages import MessageError
from synchronizar.live.origin import is_own
from synchronizar.live.room import Room

PAGES = Path(str(files("synchronizar.live"))) / "pages"
_PAGES_BY_PATH = {"/": "index.html", "/room": "room.html", "/phone": "phone.html"}
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; media-src 'self' blob:; "
        "connect-src 'self' https: wss:; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Server": "synchronizar",
    "Referrer-Policy": "no-referrer",
    "Permissions-Policy": "xr-spatial-tracking=(self), camera=(self), microphone=(self)",
    "Cache-Control": "no-cache",
}
LOOPBACK = ("127.0.0.1", "::1", "localhost")
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
_STRICT = "max-age=31536000"
"""Of a certificate that somebody vouches for: never again without. A self-signed one must not say so, since browsers
then let nobody past their warning."""
_LARGEST_BODY = 64 * 1024
_ANSWERED_WITHIN_S = 15.0
"""s from a request's head to its answer, connections apart: who sends a body so slowly is not waited for."""
_ENDS_WITHIN_S = 2.0
"""s that open connections have when the server ends."""
_KEPT_S = 30.0
"""s for which a connection is kept for the next request."""
_ASKS_WITHIN_S = 10.0
"""s from a connection to its first request's head."""
_MOST_SILENT = 200
"""Connections without a request; where there are more, those that have been silent for longest are ended."""


@dataclass(frozen=True)
class Site:
    """What the web side knows of its server."""

    lobby: Lobby
    address_of: Callable[[str], str]
    """The address by which others join a room, from its code."""
    open_room: Callable[[str | None], Room]
    """One more room, with an application or without."""
    public_url: str | None = None
    """Where there is a proxy before it: it says for whom it asks, and pages come from there."""
    strict: bool = False
    """Whether browsers are told to come by https alone."""


def runner(site: Site) -> web.AppRunner:
    """Serves the rooms of a lobby. Without a log of requests, and bodies are not unpacked: nobody needs that."""
    silence = Silence()
    app = _application(site, silence)
    out = web.AppRunner(
        app, access_log=None, auto_decompress=False, keepalive_timeout=_KEPT_S, shutdown_timeout=_ENDS_WITHIN_S
    )

    async def end_silent(_: web.Application) -> AsyncIterator[None]:
        ending = asyncio.create_task(silence.end(lambda: out.server.connections if out.server else []))
        yield
        ending.cancel()

    app.cleanup_ctx.append(end_silent)
    return out


def _application(site: Site, silence: Silence) -> web.Application:
    app = web.Application(middlewares=[_guard(site, silence)], client_max_size=_LARGEST_BODY)
    pages = _Pages(site)
    for path in _PAGES_BY_PATH:
        app.router.add_get(path, pages.page)
    app.router.add_static("/pages", PAGES)
    for name, application in loaded().items():
        if (folder := pages_of(application)).is_dir():
            app.router.add_static(f"/apps/{name}", folder)
    app.router.add_get("/api/apps", pages.apps)
    app.router.add_post("/api/join", pages.join)
    app.router.add_post("/api/rooms", pages.open)
    app.router.add_post("/api/qr", pages.qr)
    app.router.add_get("/live", pages.live)
    return app


class Silence:
    """Connections that ask for nothing are ended: each takes one of the files that the system lets a server open."""

    def __init__(self) -> None:
        self._asked: set[Any] = set()
        self._since: dict[Any, float] = {}

    def broken(self, connection: Any) -> None:
        """It has asked for something."""
        self._asked.add(connection)

    async def end(self, connections: Callable[[], list[Any]]) -> None:
        """Look once a second, without end."""
        while True:
            await asyncio.sleep(1.0)
            self.look(connections(), asyncio.get_running_loop().time())

    def look(self, connections: list[Any], now: float) -> None:
        """End those that have been silent for too long, or are too many."""
        self._asked &= set(connections)
        silent = [connection for connection in connections if connection not in self._asked]
        self._since = {connection: self._since.get(connection, now) for connection in silent}
        by_age = sorted(silent, key=self._since.__getitem__)
        too_many = len(by_age) - _MOST_SILENT
        for n, connection in enumerate(by_age):
            if (n < too_many or now - self._since[connection] > _ASKS_WITHIN_S) and connection.transport is not None:
                connection.transport.abort()


class _Pages:
    def __init__(self, site: Site) -> None:
        self._site, self._lobby = site, site.lobby

    async def page(self, request: web.Request) -> web.StreamResponse:
        return web.FileResponse(PAGES / _PAGES_BY_PATH[request.path])

    async def join(self, request: web.Request) -> web.StreamResponse:
        """A token for a room's code."""
        joined = self._lobby.join(m.decode_join(await request.read()), self._asker(request))
        return web.Response(body=m.encode(joined), content_type="application/json")

    async def apps(self, _: web.Request) -> web.StreamResponse:
        """What people can do here: applications by name."""
        told = {name: {"title": app.title, "summary": app.summary} for name, app in loaded().items()}
        return web.Response(body=msgspec.json.encode(told), content_type="application/json")

    async def open(self, request: web.Request) -> web.StreamResponse:
        """One more room, for somebody who has the code of one."""
        asked = m.decode_open_room(await request.read())
        self._lobby.may_open(asked.room, self._asker(request))
        try:
            room = self._site.open_room(asked.app)
        except InputError as error:
            raise MessageError("full", f"no room can be opened now: {error}") from error
        body = msgspec.json.encode({"room": room.code, "join": self._site.address_of(room.code)})
        return web.Response(body=body, content_type="application/json")

    async def qr(self, request: web.Request) -> web.StreamResponse:
        """The address of a room as a QR code; its code comes in the body, so that it stands in no log."""
        import segno

        room = self._lobby.room(m.decode_join(await request.read()).room, self._asker(request))
        address = self._site.address_of(room.code)
        svg = segno.make(address, error="m").svg_inline(scale=4, border=2, dark="#000", light="#fff")
        body = msgspec.json.encode({"join": address, "svg": svg})
        return web.Response(body=body, content_type="application/json")

    async def live(self, request: web.Request) -> web.StreamResponse:
        """A connection by WebSocket."""
        socket = web.WebSocketResponse(heartbeat=15.0, max_msg_size=m.LARGEST_MESSAGE, compress=False)
        await socket.prepare(request)
        await serve_link(_SocketLink(socket, self._asker(request)), self._lobby)
        return socket

    def _asker(self, request: web.Request) -> str:
        """Whose limits hold: behind a proxy that of which it says that it asks; others may say what they like."""
        if self._site.public_url is not None and request.remote in LOOPBACK:
            return request.headers.get("X-Forwarded-For", "").rpartition(",")[2].strip() or request.remote
        return request.remote or ""


class _SocketLink:
    def __init__(self, socket: web.WebSocketResponse, address: str) -> None:
        self._socket, self.address = socket, address

    async def received(self) -> AsyncIterator[str | bytes]:
        async for message in self._socket:
            if message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
                yield message.data

    async def send(self, data: bytes, text: bool) -> None:
        if text:
            await self._socket.send_str(data.decode())
        else:
            await self._socket.send_bytes(data)

    async def close(self) -> None:
        await self._socket.close()


def _refused(error: MessageError) -> web.Response:
    status = {"origin": 403, "tries": 429, "waiting": 429, "room": 404, "full": 503}.get(error.reason, 400)
    body = msgspec.json.encode({"reason": error.reason, "what": str(error)})
    return web.Response(status=status, body=body, content_type="application/json")


def _guard(site: Site, silence: Silence) -> Any:
    """Other pages' scripts are kept out, nobody is waited for, and every answer has its headers."""
    headers = _HEADERS | ({"Strict-Transport-Security": _STRICT} if site.strict else {})

    @web.middleware
    async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
        silence.broken(request.protocol)
        try:
            if not is_own(request.headers.get("Origin"), request.host, site.public_url):
                raise MessageError("origin", "from a browser only this server's own pages may come in")
            async with asyncio.timeout(None if request.path == "/live" else _ANSWERED_WITHIN_S):
                response = await handler(request)
        except MessageError as error:
            site.lobby.refused[error.reason] += 1
            response = _refused(error)
        except TimeoutError:
            response = web.Response(status=408)
        except web.HTTPException as error:
            error.headers.update(headers)
            raise
        if not response.prepared:
            response.headers.update(headers)
            if request.method == "POST":
                response.headers["Cache-Control"] = "no-store"
        return response

    return guard
