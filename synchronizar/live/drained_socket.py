"""A UDP port that is read as fast as datagrams come: a burst of modules' is not lost."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any

RECEIVE_BUFFER = 4 * 1024 * 1024
"""Bytes that the system keeps while the loop is busy."""
DRAINED_AT_ONCE = 256
"""Datagrams that are read before others get their turn."""
LARGEST_DATAGRAM = 2048


class DrainedSocket:
    """Hands each datagram that comes to `heard`, with its sender's address; there must be a running loop."""

    def __init__(self, host: str | None, port: int, heard: Callable[[bytes, Any], None]) -> None:
        """Raises OSError where the port cannot be listened at."""
        self._heard = heard
        family = socket.AF_INET6 if host is not None and ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self._socket.setblocking(False)
        try:
            self._socket.bind((host or ("::" if family == socket.AF_INET6 else "0.0.0.0"), port))
        except OSError:
            self._socket.close()
            raise
        asyncio.get_running_loop().add_reader(self._socket, self._read)

    @property
    def port(self) -> int:
        """Its number."""
        return int(self._socket.getsockname()[1])

    def send(self, data: bytes, to: Any) -> None:
        """A datagram, which may be lost."""
        with suppress(OSError):
            self._socket.sendto(data, to)

    def close(self) -> None:
        """Listen no more."""
        asyncio.get_running_loop().remove_reader(self._socket)
        self._socket.close()

    def _read(self) -> None:
        for _ in range(DRAINED_AT_ONCE):
            try:
                data, source = self._socket.recvfrom(LARGEST_DATAGRAM)
            except OSError:
                return  # nothing more, or somebody that is gone
            self._heard(data, source)
