"""Everybody in a room: who speaks for whom, and words to one or all of them."""

from __future__ import annotations

from collections import Counter
from typing import Any

from synchronizar.live import messages as m
from synchronizar.live.member import Client, Device
from synchronizar.live.messages import MessageError


class People:
    """All devices that a room knows, and the connections that are open."""

    def __init__(self) -> None:
        self.devices: dict[str, Device] = {}
        self.clients: set[Client] = set()
        self.version = 0
        """Rises when there is something else to remember of them."""
        self.refused: Counter[str] = Counter()
        """Of what could not be told to be anybody's."""

    def own(self, client: Client, name: str) -> Device:
        """A device that a connection speaks for. Raises MessageError."""
        for device in client.devices:
            if device.name == name:
                return device
        raise MessageError("user", f"this connection does not speak for {name!r}")

    def moving(self, client: Client, name: str) -> Device:
        """The same, of one that has SLAM. Raises MessageError."""
        device = self.own(client, name)
        if device.settings.static:
            raise MessageError("static", f"{name} stands still: it has no SLAM")
        return device

    def speaker(self, client: Client) -> str:
        """In whose name a connection changes anything. Raises MessageError."""
        if not client.name:
            raise MessageError("spectator", "who only looks changes nothing: join with a device")
        return client.name

    def client_of(self, name: str) -> Client:
        """The connection that speaks for a device, or is the application. Raises MessageError."""
        if name == m.APP:
            for client in self.clients:
                if client.app:
                    return client
            raise MessageError("app", "nothing is done here, or it is being begun again: try again in some seconds")
        device = self.devices.get(name)
        if device is None or device.client is None:
            raise MessageError("user", f"{name!r} is not here")
        return device.client

    def is_empty(self) -> bool:
        """Whether nobody is here, whatever application there is."""
        return all(client.app for client in self.clients)

    def members(self) -> list[m.Member]:
        """Everybody, as others are told of them."""
        return [device.member() for device in self.devices.values()]

    def tell_members(self) -> None:
        """Somebody has come, gone or changed."""
        self.version += 1
        self.tell(m.Members(self.members()))

    def tell(self, message: Any) -> None:
        """A word to everybody, which must arrive."""
        word = m.encode(message)
        for client in self.clients:
            client.outbox.put(word)

    def tell_latest(self, kind: str, message: Any) -> None:
        """A word to everybody that takes the place of an earlier one of its kind."""
        word = m.encode(message)
        for client in self.clients:
            client.outbox.latest(kind, word)

    def refuse(self, client: Client, error: MessageError) -> None:
        """Count it, and tell the client when it is news."""
        client.told[error.reason] += 1
        for device in client.devices:
            device.refused[error.reason] += 1
        if not client.devices:
            self.refused[error.reason] += 1
        count = client.told[error.reason]
        if count in (1, 10, 100) or count % 1000 == 0:
            client.outbox.put(m.encode(m.Refused(error.reason, str(error), count)))
