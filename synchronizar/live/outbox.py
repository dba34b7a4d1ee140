"""What waits to be sent to one client: words that must all arrive, and those of which only the latest counts."""

from __future__ import annotations

import asyncio
from collections import deque

MOST_WORDS = 2000
"""Words that wait at most; a client that takes none of them any more is let go."""
MOST_BYTES = 8 * 1024 * 1024
"""Bytes of them at most; all objects of a room are less."""


class Outbox:
    """Filled by the room, emptied by the client's own task; the room never waits."""

    def __init__(self) -> None:
        self.overflowed = False
        self.closed = False
        self._words: deque[bytes] = deque()
        self._bytes = 0
        self._latest: dict[str, bytes] = {}
        self._something = asyncio.Event()

    def put(self, word: bytes) -> None:
        """A word that must arrive."""
        if len(self._words) >= MOST_WORDS or self._bytes + len(word) > MOST_BYTES:
            self.overflowed = True
        else:
            self._bytes += len(word)
            self._words.append(word)
        self._something.set()

    def latest(self, kind: str, word: bytes) -> None:
        """A word that takes the place of an earlier one of its kind."""
        self._latest[kind] = word
        self._something.set()

    def close(self) -> None:
        """Nothing more comes; what waits is still to be sent."""
        self.closed = True
        self._something.set()

    @property
    def empty(self) -> bool:
        """Whether nothing waits."""
        return not self._words and not self._latest

    def take(self) -> list[bytes]:
        """All that waits."""
        words = [*self._words, *self._latest.values()]
        self._words.clear()
        self._bytes = 0
        self._latest.clear()
        self._something.clear()
        return words

    async def wait(self) -> None:
        """Until something waits, or nothing more will."""
        if not self.closed:
            await self._something.wait()
