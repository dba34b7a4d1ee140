"""What devices say to one another: the room hands it on and does not look into it."""

from __future__ import annotations

from collections.abc import Callable

from synchronizar.live import messages as m
from synchronizar.live.member import Client
from synchronizar.live.messages import MessageError
from synchronizar.live.people import People


class HandingOn:
    """Hands on the words of one room."""

    def __init__(self, people: People, now: Callable[[], float]) -> None:
        self._people, self._now = people, now

    def say(self, client: Client, message: m.Say) -> m.Said:
        """To one device, to the application, or to all others; what was said."""
        if m.data_too_large(message.data):
            raise MessageError("size", f"data has at most {m.LARGEST_DATA} bytes as JSON")
        # Who only looks may speak to the application, which knows what it lets people do.
        by = client.name if message.to == m.APP else self._people.speaker(client)
        word = m.Said(message.topic[: m.LONGEST_NAME], message.data, by)
        said = m.encode(word)
        self._spend(client, said)
        if message.to is None:
            for other in self._people.clients - {client}:
                other.outbox.put(said)
        else:
            self._people.client_of(message.to).outbox.put(said)
        return word

    def signal(self, client: Client, message: m.Signal) -> None:
        """To another device, for a channel between the two."""
        signalled = m.encode(m.Signalled(self._people.speaker(client), message.data))
        self._spend(client, signalled)
        self._people.client_of(message.to).outbox.put(signalled)

    def _spend(self, client: Client, word: bytes) -> None:
        if not client.allowance.handed_on(self._now(), len(word)):
            raise MessageError("rate", "too much is said to others a second: say less")
