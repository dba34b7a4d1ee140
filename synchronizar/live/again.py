"""A recorded room's words and objects, once more: whoever plays a recording says what became of them, and when."""

from __future__ import annotations

from collections.abc import Callable

from synchronizar.live import messages as m
from synchronizar.live.member import Client
from synchronizar.live.messages import MessageError
from synchronizar.live.objects import ObjectStore
from synchronizar.live.people import People
from synchronizar.live.room_time import need_recorded


class Again:
    """Of one room. Nothing else is done there from the first word on: two would tell of the same objects."""

    def __init__(self, people: People, objects: ObjectStore) -> None:
        self.begun: Callable[[], None] | None = None
        """Ends the room's application; hears it once."""
        self._people, self._objects = people, objects
        self.goes_on = False

    def hear(self, client: Client, message: m.Again) -> None:
        """Raises MessageError where it cannot be."""
        need_recorded(client)
        self._begin()
        if message.object is not None:
            self._objects.put(message.object)
        if message.removed is not None:
            self._objects.drop(message.removed)
        if message.said is not None:
            self._say(client, message.said)

    def _begin(self) -> None:
        if self.goes_on:
            return
        self.goes_on = True
        for client in [client for client in self._people.clients if client.app]:
            client.outbox.close()
        for id_ in [o.id for o in self._objects.objects.values() if o.by == m.APP]:
            self._objects.drop(id_)
        if self.begun is not None:
            self.begun()

    def _say(self, client: Client, said: m.Said) -> None:
        if len(said.topic) > m.LONGEST_NAME or len(said.by) > m.LONGEST_NAME or m.data_too_large(said.data):
            raise MessageError("size", f"a word has a topic of at most {m.LONGEST_NAME} characters")
        word = m.encode(said)
        for other in self._people.clients - {client}:
            other.outbox.put(word)
