"""`synchronizar serve`: one process that people join."""

from __future__ import annotations

import asyncio
import gc
import json
import secrets
import signal
import ssl
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aiohttp import web

from synchronizar.errors import InputError
from synchronizar.live.app_process import AppProcess
from synchronizar.live.app_run import Place
from synchronizar.live.applications import application
from synchronizar.live.certificates import own_addresses, server_context, state_folder
from synchronizar.live.connection import serve_link
from synchronizar.live.lobby import Lobby, new_code
from synchronizar.live.loop_lag import LoopLag
from synchronizar.live.object_file import OBJECTS_FILE, ObjectFile
from synchronizar.live.recorder import FolderRecorder
from synchronizar.live.room import Room
from synchronizar.live.room_host import RoomClock, RoomHost
from synchronizar.live.roster import Roster, read_roster
from synchronizar.live.udp import UdpPort
from synchronizar.live.web import LOOPBACK, Site, runner
from synchronizar.parameters import SleepParameters

if TYPE_CHECKING:
    from synchronizar.live.webrtc import RoomPeers
    from synchronizar.live.webtransport import WebTransportPort

IDLE_S = 3600.0
"""s after which a room without anybody is closed."""


@dataclass(frozen=True)
class ServerOptions:
    """What `serve` was asked for."""

    host: str | None = None
    """Address to listen at; None: all of this machine's."""
    port: int = 47180
    """TCP; 0: any that is free."""
    udp_port: int = 47190
    """Where modules send their ranges; 0: any that is free."""
    allow_version_1: bool = False
    """Whether modules may sign with the room's own key, as in version 1 of their protocol."""
    keep_awake: bool = False
    """Whether modules range all the time."""
    record: Path | None = None
    """A folder in which each room writes its own."""
    resume: bool = False
    """Go on with all rooms that were recorded in that folder."""
    public_url: str | None = None
    """Under which address others reach it, where that is another one: behind a proxy."""
    certificate: Path | None = None
    """PEM file with certificate and key; None: a self-signed one."""
    tls: bool = True
    workers: int = 1
    json: bool = False
    app: str | None = None
    """What people do in its rooms: an application's name."""


async def serve(options: ServerOptions, started: Callable[[dict[str, object]], None]) -> None:
    """Serve until somebody ends it; `started` hears where, once it listens. Raises InputError where it cannot."""
    if not options.tls and options.host not in LOOPBACK:
        raise InputError("--no-tls", "a phone needs https: without TLS the server listens at --host 127.0.0.1 alone")
    if options.resume and options.record is None:
        raise InputError("--resume", "needs --record DIR: the folder in which the rooms were recorded")
    if options.app is not None:
        application(options.app)
    context, certificate = server_context(options.certificate) if options.tls else (None, None)
    _open_many_files()
    server = Server(options, context, certificate)
    try:
        started(await server.start())
        gc.freeze()  # what was imported is never garbage: looking through it takes tens of ms whenever that is done
        await _ended()
    finally:
        await server.close()


class Server:
    """The parts of a server, started and closed."""

    def __init__(
        self,
        options: ServerOptions,
        context: ssl.SSLContext | None,
        certificate: bytes | None = None,
        clock: Callable[[], float] | None = None,
    ) -> None:
        """`context`: with what to serve, None: without TLS; `certificate`: the one in it, in DER.

        `clock`: of all rooms (s), one that only goes forwards; None: a clock of its own.
        """
        self.options = options
        self.clock = clock or RoomClock()
        self.lobby = Lobby(self.clock)
        self.hosts: list[RoomHost] = []
        self._context = context
        self._certificate_sha256 = None if certificate is None else sha256(certificate).hexdigest()
        self._url = ""
        self._runner: web.AppRunner | None = None
        self._udp: UdpPort | None = None
        self._lag = LoopLag()
        self._tasks: list[asyncio.Task[None]] = []
        self._webtransport: WebTransportPort | None = None
        self._peers: RoomPeers | None = None

    async def start(self) -> dict[str, object]:
        """Listen, open a room, and say where. Raises InputError where the port is taken."""
        options = self.options
        strict = self._context is not None and options.certificate is not None
        self._runner = runner(Site(self.lobby, self.join_address, self.open_room, options.public_url, strict))
        await self._runner.setup()
        site = web.TCPSite(self._runner, options.host, options.port, ssl_context=self._context)
        try:
            await site.start()
        except OSError as error:
            raise InputError(
                "--port", f"{options.port} cannot be listened at: {error.strerror}; choose another"
            ) from error
        port = self.port
        self._open_webrtc()
        if self._context is not None:
            await self._open_webtransport(port)
        name = options.host if options.host not in (None, "0.0.0.0", "::") else own_addresses()[0]
        host = f"[{name}]" if name and ":" in name else name
        self._url = (options.public_url or f"{'https' if self._context else 'http'}://{host}:{port}").rstrip("/")
        self._udp = UdpPort(self.lobby, self.clock, options.host, options.udp_port)
        self._tasks = [asyncio.create_task(beat) for beat in (self._close_idle(), self._lag.run())]
        room = self.open_rooms_again()[-1] if options.resume else self.open_room()
        return {"url": self._url, "room": room.code, "join": self.join_address(room.code), "udp_port": room.udp_port}

    async def _open_webtransport(self, port: int) -> None:
        """At the same number as TCP, where the extra is installed."""
        try:
            from synchronizar.live.webtransport import WebTransportPort
        except ModuleNotFoundError:
            return
        self._webtransport = await WebTransportPort.open(
            self.options.host, port, lambda link: serve_link(link, self.lobby), self.options.public_url
        )
        self.lobby.webtransport = self._webtransport.port, self._webtransport.certificate_sha256.hex()

    def _open_webrtc(self) -> None:
        """Data channels for whoever is connected, where the extra is installed."""
        try:
            from synchronizar.live.webrtc import RoomPeers
        except ModuleNotFoundError:
            return
        self._peers = RoomPeers()

    @property
    def port(self) -> int:
        """TCP port at which it listens."""
        assert self._runner is not None
        return int(self._runner.addresses[0][1])

    def join_address(self, code: str) -> str:
        """The address that phones and `play` join by: its fragment, the code, is seen and logged by no server."""
        return f"{self._url}/#{code}"

    def open_room(self, app: str | None = None) -> Room:
        """One more room, with the server's application or with another one.

        Raises InputError where its folder cannot be written, or there is no such application.
        """
        app = app or self.options.app
        if app is not None:
            application(app)
        if self.options.record is None:
            room = Room(new_code(), self.clock, udp_port=self._udp_port, app=app, **self._modules())
            return self._host(room, None, None)
        name = f"room-{time.strftime('%Y%m%d-%H%M%S')}-{secrets.token_hex(2)}"
        return self._recorded_room(self.options.record / name, None, app)

    def open_rooms_again(self) -> list[Room]:
        """All rooms that were recorded here before. Raises InputError where there is none, or one cannot be read."""
        assert self.options.record is not None
        folders = sorted(self.options.record.glob("room-*"))
        known = [(folder, roster) for folder in folders if (roster := read_roster(folder)) is not None]
        if not known:
            raise InputError(self.options.record, "no room was recorded here by this user: leave --resume out")
        return [self._recorded_room(folder, roster, roster.app or self.options.app) for folder, roster in known]

    @property
    def _udp_port(self) -> int | None:
        return None if self._udp is None else self._udp.port

    def _modules(self) -> dict[str, Any]:
        """What holds for modules in all rooms."""
        sleep = SleepParameters(settled=float("inf")) if self.options.keep_awake else None
        return {"allow_version_1": self.options.allow_version_1, "sleep": sleep}

    def _recorded_room(self, folder: Path, roster: Roster | None, app: str | None) -> Room:
        recorder = FolderRecorder(folder)
        objects = ObjectFile(folder / OBJECTS_FILE)
        code, key = (new_code(), None) if roster is None else (roster.code, bytes.fromhex(roster.key))
        room = Room(code, self.clock, key, recorder, self._udp_port, app, saved=objects.save, **self._modules())
        return self._host(room, recorder, objects, roster)

    def _host(
        self, room: Room, recorder: FolderRecorder | None, objects: ObjectFile | None, roster: Roster | None = None
    ) -> Room:
        room.lag = self._lag.told
        host = RoomHost(room, self.options.workers, recorder, objects)
        room.open_peer = None if self._peers is None else self._peers.open
        host.start()
        self.hosts.append(host)
        if roster is not None:
            host.resume(roster)
        self.lobby.add(room)
        if room.app is not None:
            files = (self.options.record or state_folder()) / "apps" / room.app
            place = Place(self._own_address(room.code), room.app_secret, self._certificate_sha256, str(files))
            host.begin_app(AppProcess(room.app, place, room.event))
        return room

    def _own_address(self, code: str) -> str:
        """A room's address from this machine itself."""
        host = self.options.host if self.options.host not in (None, "0.0.0.0", "::") else "127.0.0.1"
        host = f"[{host}]" if host and ":" in host else host
        return f"{'https' if self._context else 'http'}://{host}:{self.port}/#{code}"

    async def _close_idle(self) -> None:
        """Rooms in which nobody has been for long, but the first: what they wrote stays."""
        while True:
            await asyncio.sleep(60.0)
            for host in [host for host in self.hosts[1:] if host.room.idle_for() > IDLE_S]:
                self.hosts.remove(host)
                self.lobby.remove(host.room)
                await host.close()

    async def close(self) -> None:
        """Everything ended and on disk."""
        for task in self._tasks:
            task.cancel()
        if self._udp is not None:
            self._udp.close()
        if self._webtransport is not None:
            self._webtransport.close()
        if self._runner is not None:
            await self._runner.cleanup()
        for host in self.hosts:
            await host.close()
        if self._peers is not None:
            await self._peers.close()


def announce(where: dict[str, object], options: ServerOptions) -> None:
    """Say where the server is: one line of JSON, or an address and its QR code for people."""
    if options.json:
        print(json.dumps(where), flush=True)
        return
    print(f"room {where['room']}\njoin {where['join']}\nlook {where['url']}/room#{where['room']}")
    if sys.stdout.isatty():
        import segno

        segno.make(str(where["join"]), error="m").terminal(compact=True)
    sys.stdout.flush()


def _open_many_files() -> None:
    """As many as this user may: each connection is one, and some systems begin with 256."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


async def _ended() -> None:
    """Until Ctrl-C or a polite kill."""
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    await ended.wait()
