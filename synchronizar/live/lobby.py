"""Rooms by their codes, and the tokens that joining buys."""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256

from synchronizar.live.budget import Tally
from synchronizar.live.joining import TOKEN_S
from synchronizar.live.member import Ticket
from synchronizar.live.messages import Join, Joined, MessageError
from synchronizar.live.room import Room

ALPHABET = "ABCDEFGHJKMNPQRSTUVWXYZ23456789"
"""Without those that are taken for one another."""
CODE_LENGTH = 8
"""Characters: 40 bits, which nobody guesses at the rate that is allowed."""
MOST_ROOMS = 50
"""In one process: each has a solver of its own."""
OPENED_A_MINUTE = 5
"""Rooms from one address."""
TRIES_A_MINUTE = 30
"""Wrong codes from one address; more are refused unread."""
JOINS_A_MINUTE = 600
"""Tokens for one address; it may be a gateway's, or a proxy's that does not say for whom it asks."""
MOST_TOKENS = 5000
"""Tokens that wait for their hello."""
MOST_WAITING, MOST_WAITING_FROM_ONE = 512, 128
"""Connections that have not said hello yet, in all and from one address."""


def new_code() -> str:
    """A room's code."""
    return "".join(secrets.choice(ALPHABET) for _ in range(CODE_LENGTH))


class Lobby:
    """All rooms of a server."""

    def __init__(self, now: Callable[[], float]) -> None:
        """`now`: s, a clock that only goes forwards."""
        self.rooms: dict[str, Room] = {}
        self.by_session: dict[int, Room] = {}
        """Rooms by the number that their modules' datagrams carry."""
        self.refused: Counter[str] = Counter()
        """Connections that were let into no room, by reason."""
        self.webtransport: tuple[int, str] | tuple[()] = ()
        """Port and hash of the certificate, where there is one."""
        self._now = now
        self._bought: dict[bytes, tuple[Room, Ticket]] = {}
        self._wrong, self._joined, self._opened = Tally(TRIES_A_MINUTE), Tally(JOINS_A_MINUTE), Tally(OPENED_A_MINUTE)
        self._waiting: Counter[str] = Counter()

    def add(self, room: Room) -> None:
        """One more room."""
        self.rooms[room.code] = room
        self.by_session[room.modules.session] = room
        room.refused_outside = self.refused

    def room(self, code: str, address: str) -> Room:
        """The room with a code, however it is written. Raises MessageError where there is none, or too many tries."""
        now = self._now()
        if self._wrong.full(address, now):
            raise MessageError("tries", "too many wrong codes: wait a minute")
        room = self.rooms.get(code.strip().upper().replace("-", "").replace(" ", ""))
        if room is None:
            self._wrong.count(address)
            raise MessageError("room", "there is no room with that code: look at the room's page for it")
        return room

    def join(self, join: Join, address: str) -> Joined:
        """Sell a token. Raises MessageError where the code is wrong, or the room does not take these devices."""
        room, now = self.room(join.room, address), self._now()
        if self._joined.full(address, now):
            raise MessageError("tries", "too many joined from here: wait a minute")
        self._joined.count(address)
        self._bought = {digest: bought for digest, bought in self._bought.items() if bought[1].until >= now}
        if len(self._bought) >= MOST_TOKENS:
            raise MessageError("full", "too many are joining: wait a minute")
        ticket, secret = room.admit(join)
        token = secrets.token_urlsafe(24)
        self._bought[_digest(token)] = room, ticket
        return Joined(token, TOKEN_S, secret, room.code, ticket.users, *self.webtransport)

    def may_open(self, code: str, address: str) -> None:
        """Count a room that somebody who is in one opens. Raises MessageError where it may not, or there are too many.

        `code`: of a room of this server, so that no stranger opens any.
        """
        self.room(code, address)
        if self._opened.full(address, self._now()):
            raise MessageError("tries", "too many rooms were opened from here: wait a minute")
        self._opened.count(address)
        if len(self.rooms) >= MOST_ROOMS:
            raise MessageError("full", f"this server has its {MOST_ROOMS} rooms: use another one")

    def remove(self, room: Room) -> None:
        """Nobody can join it any more."""
        self.rooms.pop(room.code, None)
        self.by_session.pop(room.modules.session, None)
        self._bought = {digest: bought for digest, bought in self._bought.items() if bought[0] is not room}

    @contextmanager
    def waiting(self, address: str) -> Iterator[None]:
        """While a connection has not said hello. Raises MessageError where too many have not."""
        if self._waiting.total() >= MOST_WAITING or self._waiting[address] >= MOST_WAITING_FROM_ONE:
            raise MessageError("waiting", "too many connections have not said hello: try again in some seconds")
        self._waiting[address] += 1
        try:
            yield
        finally:
            self._waiting[address] -= 1
            if not self._waiting[address]:
                del self._waiting[address]

    def redeem(self, token: str) -> tuple[Room, Ticket]:
        """What a token has bought. Raises MessageError where it is none, was used, or is too old."""
        bought = self._bought.pop(_digest(token), None)
        if bought is None or bought[1].until < self._now():
            raise MessageError("token", "this token is none, or was used, or is too old: join again")
        return bought


def _digest(token: str) -> bytes:
    """Looked up by its hash, so that the time of the search says nothing about tokens."""
    return sha256(token.encode()).digest()
