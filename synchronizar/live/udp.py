"""Modules' datagrams: one port for all rooms, told apart by the session that stands in each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from synchronizar.errors import InputError
from synchronizar.io.datagrams import session_of
from synchronizar.live.drained_socket import DrainedSocket
from synchronizar.live.lobby import Lobby
from synchronizar.live.room import Room


class UdpPort:
    """Reads whatever comes, and hands it to the room of its session."""

    def __init__(self, lobby: Lobby, now: Callable[[], float], host: str | None, port: int) -> None:
        """Raises InputError where the port cannot be listened at."""
        self._lobby, self._now = lobby, now
        try:
            self._socket = DrainedSocket(host, port, self.hear)
        except OSError as error:
            raise InputError("--udp-port", f"{port} cannot be listened at: {error.strerror}; choose another") from error

    @property
    def port(self) -> int:
        """Its number."""
        return self._socket.port

    def close(self) -> None:
        """Listen no more."""
        self._socket.close()

    def hear(self, data: bytes, source: Any) -> None:
        """A datagram from an address, which may be anybody's and anything."""
        arrived = self._now()
        room = self._room_of(data)
        if room is None:
            self._lobby.refused["datagram session"] += 1
        elif (heard := room.hear_datagram(data, arrived)) is not None:
            for order in room.orders_for(heard, arrived):
                self._socket.send(order, source)

    def _room_of(self, data: bytes) -> Room | None:
        session = session_of(data)
        return None if session is None else self._lobby.by_session.get(session)
