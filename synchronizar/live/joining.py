"""Who may come into a room, as whom, and what becomes of them when they go."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from hashlib import sha256

from synchronizar.live import messages as m
from synchronizar.live.budget import Allowance
from synchronizar.live.checks import alike, check_settings, is_taken
from synchronizar.live.given import Given
from synchronizar.live.member import Client, Device, Ticket
from synchronizar.live.messages import MessageError
from synchronizar.live.people import People
from synchronizar.live.room_time import RoomTime

TOKEN_S = 60.0
"""s for which a token may be used, once, and for which its devices' names are kept for it."""
MOST_DEVICES = 64
MOST_SPECTATORS = 128
APP_COUNTS_AS = 8
"""Devices, in how much an application may say."""


class Joining:
    """Lets people into one room, and out of it."""

    def __init__(self, people: People, time: RoomTime, given: Given, app_secret: str | None = None) -> None:
        """`app_secret`: what the room's application says; None where there is none."""
        self._people, self._time, self._given = people, time, given
        self._app_secret = app_secret
        self._empty_since = time.now()
        self._tickets: list[Ticket] = []
        """Of those who have not come yet."""

    def admit(self, join: m.Join) -> tuple[Ticket, str]:
        """Who may come in as whom, and the secret to come again. Raises MessageError with a way on.

        Names are kept for them for as long as the ticket holds; the room changes when they come.
        """
        if join.app is not None:
            return self._admit_app(join), ""
        now, recorded = self._time.now(), join.time == "recorded" and bool(join.users)
        self._tickets = [ticket for ticket in self._tickets if ticket.until >= now]
        owners = {device.name: device.owner for device in self._people.devices.values()}
        owners |= {name: ticket.owner for ticket in self._tickets for name in ticket.users}
        secret, owner = join.resume or "", _owner(join.resume or "")
        if owner not in owners.values():  # a secret that is not of this room's making may be easy to guess
            secret = secrets.token_urlsafe(24)
            owner = _owner(secret)
        ticket = Ticket(join.users, owner, recorded, now + TOKEN_S)
        self._check_time(ticket)
        if len({alike(name) for name in ticket.users}) != len(ticket.users):
            raise MessageError("name", "two devices of one connection have the same name")
        for user in join.users:
            check_settings(user)
            self._check_name(user.name, owner, owners)
        if len(owners.keys() | set(ticket.users)) > MOST_DEVICES:
            raise MessageError("full", f"the room has its {MOST_DEVICES} devices: open another room")
        self._tickets.append(ticket)
        return ticket, secret

    def _admit_app(self, join: m.Join) -> Ticket:
        known = self._app_secret
        if known is None or not secrets.compare_digest(known.encode(), (join.app or "").encode()):
            raise MessageError("app", "only the application that the server has started may say that it is that")
        if join.users:
            raise MessageError("app", "an application speaks for no device: its robots join by themselves")
        return Ticket([], "", False, self._time.now() + TOKEN_S, app=True)

    def connect(self, ticket: Ticket) -> Client:
        """Its connection stands. Raises MessageError where it cannot come in."""
        self._check_time(ticket)
        people = self._people
        if ticket.app:
            return self._connect_app()
        if not ticket.settings and sum(not client.name for client in people.clients) >= MOST_SPECTATORS:
            raise MessageError("full", f"{MOST_SPECTATORS} look already: come later")
        self._tickets = [other for other in self._tickets if other is not ticket]
        if ticket.settings:
            self._time.begin(ticket.recorded)
        for user in ticket.settings:
            if user.name not in people.devices:
                people.devices[user.name] = Device(user, len(people.devices), ticket.owner)
                self._given.user(people.devices[user.name])
        devices = [people.devices[name] for name in ticket.users]
        client = Client(devices, ticket.recorded, Allowance(len(devices), self._time.now()))
        for device in devices:
            if (earlier := device.client) is not None:
                self.disconnect(earlier)
                earlier.outbox.put(m.encode(m.Bye("elsewhere", "the same device has joined from somewhere else")))
                earlier.outbox.close()
            device.client, device.left_at = client, None
            device.clock.reconnect()
        people.clients.add(client)
        return client

    def _connect_app(self) -> Client:
        """It takes the place of the one before, which may not have noticed its end."""
        for earlier in [client for client in self._people.clients if client.app]:
            self.disconnect(earlier)
            earlier.outbox.close()
        client = Client([], False, Allowance(APP_COUNTS_AS, self._time.now()), app=True)
        self._people.clients.add(client)
        return client

    def disconnect(self, client: Client) -> None:
        """Its connection is gone; its devices may come again."""
        self._people.clients.discard(client)
        if client.peer is not None:
            client.peer.close()
            client.peer = None
        if self._people.is_empty():
            self._empty_since = self._time.now()
        gone = [device for device in client.devices if device.client is client]
        for device in gone:
            device.client, device.left_at = None, self._time()
        if gone:
            self._people.tell_members()

    def leave(self, client: Client) -> None:
        """It goes of itself."""
        client.outbox.put(m.encode(m.Bye("left", "you have left the room")))
        self.disconnect(client)
        client.outbox.close()

    def idle_for(self) -> float:
        """How long (s) nobody has been here."""
        return self._time.now() - self._empty_since if self._people.is_empty() else 0.0

    def sessions(self) -> dict[str, int]:
        """How often SLAM began anew, by names as `alike`, of all devices and of those who have not come yet."""
        coming = {alike(name): 0 for ticket in self._tickets for name in ticket.users}
        return coming | {alike(device.name): device.session for device in self._people.devices.values()}

    def _check_time(self, ticket: Ticket) -> None:
        if ticket.settings and self._time.recorded not in (None, ticket.recorded):
            kind = "a recording" if self._time.recorded else "people who walk now"
            raise MessageError("time", f"this room plays {kind}: open another room")

    def _check_name(self, name: str, owner: str, owners: Mapping[str, str]) -> None:
        """Whether somebody may have it; `owners` of all names that are known or kept."""
        if name in (m.ROOM, m.APP):
            raise MessageError("name", f"{name!r} is the room itself: choose another name")
        if name in owners:
            if not secrets.compare_digest(owners[name], owner):
                raise MessageError("name", f"there is somebody called {name!r} already: choose another name")
        elif is_taken(name, self.sessions()):
            raise MessageError("name", f"{name!r} is too much like a name that is there already: choose another one")


def _owner(secret: str) -> str:
    return sha256(secret.encode()).hexdigest()
