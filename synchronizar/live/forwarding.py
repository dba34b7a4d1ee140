"""Modules that talk to their own device alone: it hands their datagrams on, and the room's orders back.

The datagrams stay as they are, tag and all: the device needs no key, and can change nothing in them.
"""

from __future__ import annotations

import socket
from typing import Any

from synchronizar.errors import InputError
from synchronizar.live.drained_socket import DrainedSocket

MOST_MODULES = 16
"""Of one device; who comes after them is not heard."""


class ModuleForwarder:
    """Listens at a UDP port for the modules of a device."""

    def __init__(self, room: tuple[str, int], host: str | None = None, port: int = 0) -> None:
        """`room`: host and UDP port. `host`: where to listen, None: everywhere. Raises InputError where it cannot."""
        try:
            found = socket.getaddrinfo(*room, type=socket.SOCK_DGRAM)
            self._room = found[0][4]
            self._any = "::" if found[0][0] == socket.AF_INET6 else None
            self._near = DrainedSocket(host, port, self._from_module)
        except OSError as error:
            raise InputError("forward_module", f"UDP {port}: {error.strerror or error}") from error
        self._far: dict[Any, DrainedSocket] = {}

    @property
    def port(self) -> int:
        """What a module is told as its collector's port."""
        return self._near.port

    def close(self) -> None:
        """Listen no more."""
        for one in (self._near, *self._far.values()):
            one.close()

    def _from_module(self, data: bytes, source: Any) -> None:
        """Each module has a port of its own towards the room, by which orders find back to it."""
        far = self._far.get(source)
        if far is None:
            if len(self._far) >= MOST_MODULES:
                return
            far = DrainedSocket(self._any, 0, lambda order, _: self._near.send(order, source))
            self._far[source] = far
        far.send(data, self._room)
