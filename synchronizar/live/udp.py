"""Modules' datagrams: one port for all rooms, told apart by the session that stands in each."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import Any

from synchronizar.errors import InputError
from synchronizar.io.datagrams import session_of
from synchronizar.live.lobby import Lobby
from synchronizar.live.room import Room

RECEIVE_BUFFER = 4 * 1024 * 1024
"""Bytes that the system keeps while the loop is busy."""
DRAINED_AT_ONCE = 256
"""Datagrams that are read before others get their turn."""
_LARGEST = 2048


class UdpPort:
    """Reads whatever comes, and hands it to the room of its session."""

    def __init__(self, lobby: Lobby, now: Callable[[], float], host: str | None, port: int) -> None:
        """Raises InputError where the port cannot be listened at."""
        self._lobby, self._now = lobby, now
        family = socket.AF_INET6 if host is not None and ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self._socket.setblocking(False)
        try:
            self._socket.bind((host or "0.0.0.0", port))
        except OSError as error:
            self._socket.close()
            raise InputError("--udp-port", f"{port} cannot be listened at: {error.strerror}; choose another") from error
        asyncio.get_running_loop().add_reader(self._socket, self._read)

    @property
    def port(self) -> int:
        """Its number."""
        return int(self._socket.getsockname()[1])

    def close(self) -> None:
        """Listen no more."""
        asyncio.get_running_loop().remove_reader(self._socket)
        self._socket.close()

    def _read(self) -> None:
        for _ in range(DRAINED_AT_ONCE):
            try:
                data, source = self._socket.recvfrom(_LARGEST)
            except OSError:
                return  # nothing more, or a reader that is gone
            self.hear(data, source)

    def hear(self, data: bytes, source: Any) -> None:
        """A datagram from an address, which may be anybody's and anything."""
        arrived = self._now()
        room = self._room_of(data)
        if room is None:
            self._lobby.refused["datagram session"] += 1
        elif (heard := room.hear_datagram(data, arrived)) is not None:
            for order in room.orders_for(heard, arrived):
                self._send(order, source)

    def _room_of(self, data: bytes) -> Room | None:
        session = session_of(data)
        return None if session is None else self._lobby.by_session.get(session)

    def _send(self, order: bytes, source: Any) -> None:
        try:
            self._socket.sendto(order, source)
        except OSError:
            return  # the module is gone, and the next datagram gets another answer
