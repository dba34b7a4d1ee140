"""The web side: pages, joining, and connections by WebSocket."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from importlib.resources import files
from pathlib import Path

import msgspec
from aiohttp import WSMsgType, web

from synchronizar.live import messages as m
from synchronizar.live.connection import serve_link
from synchronizar.live.lobby import Lobby
from synchronizar.live.messages import MessageError
from synchronizar.live.room import Room

PAGES = Path(str(files("synchronizar.live"))) / "pages"
_PAGES_BY_PATH = {"/": "index.html", "/room": "room.html", "/phone": "phone.html"}
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; media-src 'self' blob:; "
        "connect-src 'self' https: wss:; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Permissions-Policy": "xr-spatial-tracking=(self), camera=(self), microphone=(self)",
    "Cache-Control": "no-cache",
}
_LARGEST_BODY = 64 * 1024


def application(lobby: Lobby, address_of: Callable[[str], str], open_room: Callable[[], Room]) -> web.Application:
    """Serves the rooms of a lobby; `address_of` is the address by which others join a room, from its code."""
    app = web.Application(middlewares=[_headers], client_max_size=_LARGEST_BODY)
    pages = _Pages(lobby, address_of, open_room)
    for path in _PAGES_BY_PATH:
        app.router.add_get(path, pages.page)
    app.router.add_static("/pages", PAGES)
    app.router.add_post("/api/join", pages.join)
    app.router.add_post("/api/rooms", pages.open)
    app.router.add_post("/api/qr", pages.qr)
    app.router.add_get("/live", pages.live)
    return app


class _Pages:
    def __init__(self, lobby: Lobby, address_of: Callable[[str], str], open_room: Callable[[], Room]) -> None:
        self._lobby, self._address_of, self._open_room = lobby, address_of, open_room

    async def page(self, request: web.Request) -> web.StreamResponse:
        return web.FileResponse(PAGES / _PAGES_BY_PATH[request.path])

    async def join(self, request: web.Request) -> web.StreamResponse:
        """A token for a room's code."""
        try:
            joined = self._lobby.join(m.decode_join(await request.read()), request.remote or "")
        except MessageError as error:
            return _refused(error)
        return web.Response(body=m.encode(joined), content_type="application/json")

    async def open(self, request: web.Request) -> web.StreamResponse:
        """One more room."""
        try:
            self._lobby.may_open(request.remote or "")
            room = self._open_room()
        except MessageError as error:
            return _refused(error)
        body = msgspec.json.encode({"room": room.code, "join": self._address_of(room.code)})
        return web.Response(body=body, content_type="application/json")

    async def qr(self, request: web.Request) -> web.StreamResponse:
        """The address of a room as a QR code; its code comes in the body, so that it stands in no log."""
        import segno

        try:
            room = self._lobby.room(m.decode_join(await request.read()).room)
        except MessageError as error:
            return _refused(error)
        address = self._address_of(room.code)
        svg = segno.make(address, error="m").svg_inline(scale=4, border=2, dark="#000", light="#fff")
        body = msgspec.json.encode({"join": address, "svg": svg})
        return web.Response(body=body, content_type="application/json")

    async def live(self, request: web.Request) -> web.StreamResponse:
        """A connection by WebSocket."""
        socket = web.WebSocketResponse(heartbeat=15.0, max_msg_size=m.LARGEST_MESSAGE, compress=False)
        await socket.prepare(request)
        await serve_link(_SocketLink(socket, request.remote or ""), self._lobby)
        return socket


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
    status = {"tries": 429, "room": 404, "full": 503}.get(error.reason, 400)
    body = msgspec.json.encode({"reason": error.reason, "what": str(error)})
    return web.Response(status=status, body=body, content_type="application/json")


@web.middleware
async def _headers(
    request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
) -> web.StreamResponse:
    try:
        response = await handler(request)
    except web.HTTPException as error:
        error.headers.update(_HEADERS)
        raise
    if not response.prepared:
        response.headers.update(_HEADERS)
    return response
