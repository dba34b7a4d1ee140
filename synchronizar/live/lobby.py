"""Rooms by their codes, and the tokens that joining buys."""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256

from synchronizar.live.messages import Join, Joined, MessageError
from synchronizar.live.room import Room, Ticket

ALPHABET = "ABCDEFGHJKMNPQRSTUVWXYZ23456789"
"""Without those that are taken for one another."""
CODE_LENGTH = 8
"""Characters: 40 bits, which nobody guesses at the rate that is allowed."""
TOKEN_S = 60.0
"""s for which a token may be used, once."""
MOST_ROOMS = 50
"""In one process: each has a solver of its own."""
OPENED_A_MINUTE = 5
"""Rooms from one address."""
TRIES_A_MINUTE = 30
"""Wrong codes from one address; more are refused unread."""


def new_code() -> str:
    """A room's code."""
    return "".join(secrets.choice(ALPHABET) for _ in range(CODE_LENGTH))


@dataclass
class _Bought:
    room: Room
    ticket: Ticket
    until: float


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
        self._bought: dict[bytes, _Bought] = {}
        self._wrong: Counter[str] = Counter()
        self._opened: Counter[str] = Counter()
        self._minute = 0

    def add(self, room: Room) -> None:
        """One more room."""
        self.rooms[room.code] = room
        self.by_session[room.radio_session] = room

    def room(self, code: str) -> Room:
        """The room with a code, however it is written. Raises MessageError where there is none."""
        room = self.rooms.get(code.strip().upper().replace("-", "").replace(" ", ""))
        if room is None:
            raise MessageError("room", "there is no room with that code: look at the room's page for it")
        return room

    def join(self, join: Join, address: str) -> Joined:
        """Sell a token. Raises MessageError where the code is wrong, or the room does not take these devices."""
        self._begin_minute()
        if self._wrong[address] >= TRIES_A_MINUTE:
            raise MessageError("tries", "too many wrong codes: wait a minute")
        try:
            room = self.room(join.room)
        except MessageError:
            self._wrong[address] += 1
            raise
        ticket, owner = room.admit(join)
        now = self._now()
        self._bought = {digest: bought for digest, bought in self._bought.items() if bought.until >= now}
        token = secrets.token_urlsafe(24)
        self._bought[_digest(token)] = _Bought(room, ticket, now + TOKEN_S)
        return Joined(token, TOKEN_S, owner, room.code, ticket.users, *self.webtransport)

    def may_open(self, address: str) -> None:
        """Count a room that somebody opens. Raises MessageError where there are too many."""
        self._begin_minute()
        self._opened[address] += 1
        if self._opened[address] > OPENED_A_MINUTE:
            raise MessageError("tries", "too many rooms were opened from here: wait a minute")
        if len(self.rooms) >= MOST_ROOMS:
            raise MessageError("full", f"this server has its {MOST_ROOMS} rooms: use another one")

    def remove(self, room: Room) -> None:
        """Nobody can join it any more."""
        self.rooms.pop(room.code, None)
        self.by_session.pop(room.radio_session, None)

    def _begin_minute(self) -> None:
        if (minute := int(self._now() // 60.0)) != self._minute:
            self._minute = minute
            self._wrong.clear()
            self._opened.clear()

    def redeem(self, token: str) -> tuple[Room, Ticket]:
        """What a token has bought. Raises MessageError where it is none, was used, or is too old."""
        bought = self._bought.pop(_digest(token), None)
        if bought is None or bought.until < self._now():
            raise MessageError("token", "this token is none, or was used, or is too old: join again")
        return bought.room, bought.ticket


def _digest(token: str) -> bytes:
    """Looked up by its hash, so that the time of the search says nothing about tokens."""
    return sha256(token.encode()).digest()
