"""All users: who they are, their SLAM's poses, what is known of each, and what happened lately."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import cos, exp, sin
from typing import Any, ClassVar

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.jump import Jump
from synchronizar.data.registration import State
from synchronizar.data.user import User
from synchronizar.diagnosis.attitudes import NOT_USED, at_origin
from synchronizar.diagnosis.belief import is_upright, why_not_believed
from synchronizar.estimation.incremental.kept import kept, restore_kept
from synchronizar.estimation.incremental.standing import Placed, Standing
from synchronizar.geometry import wrap_angle
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.pose_stream import PoseStream
from synchronizar.preprocessing.stream_events import SetAside

_MOST_JUDGED = 500  # poses by which attitudes are judged


class Roster:
    """Users by their index, at one moment."""

    KEPT: ClassVar[tuple[str, ...]] = ("standings", "now", "events", "raised", "disbelieved", "held_back")

    def __init__(self, users: tuple[User, ...], reference: int, parameters: Parameters) -> None:
        self.users, self.reference, self.parameters = users, reference, parameters
        self.streams = [self._stream(user) for user in users]
        """Of each user; None for static radios."""
        self.standings = [Standing() for _ in users]
        self.raised: list[float | None] = [None for _ in users]
        """SLAM units: the level about which each stream has its heights (`raised_by`); None before the first pose."""
        self.disbelieved: list[bool] = [False for _ in users]
        """Whose attitudes cannot be believed: their antennas are taken to be at their origins."""
        self.held_back: dict[int, dict[str, tuple[float, float, float]]] = {}
        """Antennas of those whose attitudes tell nothing yet while others' cannot be believed: not used until then."""
        self.now = -np.inf
        """s, range clock."""
        self.events: list[str] = []
        """What happened since it was told last, a sentence each."""

    def _stream(self, user: User) -> PoseStream | None:
        return None if user.static else PoseStream(self.parameters)

    def add_user(self, user: User) -> None:
        """One more user, the last by index."""
        self.users = (*self.users, user)
        self.streams.append(self._stream(user))
        self.standings.append(Standing())
        self.raised.append(None)
        self.disbelieved.append(False)

    def level_of(self, user: int, height: float | None = None) -> float:
        """SLAM units: the level about which a stream has its heights, chosen by the `height` of its first pose."""
        level = self.raised[user]
        if level is None and height is not None:
            most, level = self.parameters.priors.highest_begin, 0.0
            if abs(height) > most:
                others = [other for other in self.raised if other and abs(other - height) <= most]
                level = others[0] if others else height
            self.raised[user] = level
        return level or 0.0

    def tell(self, user: int) -> None:
        """A user's state is another one: it is among what happened."""
        standing = self.standings[user]
        self.events.append(f"{self.users[user].name}: {standing.state}: {standing.reason}")

    def change(self, user: int, state: State, reason: str) -> None:
        """A user's state and why; it is told where the state is another one."""
        standing = self.standings[user]
        changed = state is not standing.state
        standing.state, standing.reason = state, reason
        if changed:
            self.tell(user)

    def look_anew(self, user: int, state: State, reason: str) -> None:
        """What was known of a user's place is not believed any more: it is looked for in what comes from now on."""
        self.standings[user].begin_again(self.now, state, reason)
        self.tell(user)

    def as_known(self, user: int) -> User:
        """A user's settings; of who went up or down without its SLAM, as in a lift, the height is nearly unknown."""
        own = self.users[user]
        if not self.standings[user].lifted:
            return own
        return replace(own, height_sigma=self.parameters.priors.static_height_sigma)

    def judge_attitudes(self) -> list[int]:
        """Take antennas of devices whose attitudes cannot be believed to be at their origins; whose that is new of.

        Devices that walk together are mostly of one kind. So where some attitudes are wrong, others are used only once
        they have told that they are right.
        """
        found, untold, told = list[int](), list[int](), list[int]()
        for u, (user, stream) in enumerate(zip(self.users, self.streams, strict=True)):
            antennas = self.held_back.get(u, user.antennas)
            if stream is None or self.disbelieved[u] or not any(any(lever) for lever in antennas.values()):
                continue
            track = stream.slam_track(_MOST_JUDGED)
            if why := why_not_believed(track, user.up, self.parameters):
                self.disbelieved[u] = True
                if self.held_back.pop(u, None) is None:
                    found.append(u)
                self._place_antennas(u, at_origin(user))
                self.events.append(f"{user.name}: {why}{NOT_USED}")
            else:
                (told if is_upright(track, user.up, self.parameters) else untold).append(u)
        for u in [u for u in told if u in self.held_back]:
            self._place_antennas(u, self.held_back.pop(u))
        for u in [u for u in untold if u not in self.held_back and any(self.disbelieved)]:
            found.append(u)
            self.held_back[u] = dict(self.users[u].antennas)
            self._place_antennas(u, at_origin(self.users[u]))
            self.events.append(f"{self.users[u].name}: others' attitudes are wrong, its own tell nothing yet{NOT_USED}")
        return sorted(found)

    def _place_antennas(self, user: int, antennas: dict[str, tuple[float, float, float]]) -> None:
        moved = replace(self.users[user], antennas=antennas)
        self.users = (*self.users[:user], moved, *self.users[user + 1 :])

    def renew_stream(self, user: int) -> None:
        """A device's SLAM tells from now on what need not continue what it told before."""
        self.streams[user] = self._stream(self.users[user])
        self.raised[user] = None
        self.standings[user].lifted = False

    def take_events(self) -> list[str]:
        """What happened since the last call."""
        events, self.events = self.events, []
        return events

    def notice_slam(self) -> bool:
        """Jumps and doubts of devices' SLAM are told; whether one jumped."""
        jumped = False
        for user, stream in enumerate(self.streams):
            if stream is None:
                continue
            for event in stream.take_events():
                if isinstance(event, Jump):
                    jumped = True
                    what = f"its SLAM jumped by {event.distance:.2f} m and {np.degrees(event.turn):.0f} deg: mended"
                    self.events.append(f"{self.users[user].name}: {what}")
                elif isinstance(event, SetAside):
                    self.events.append(f"{self.users[user].name}: {event.poses} {event.reason} poses are set aside")
        return jumped

    def doubted(self) -> set[int]:
        """Whose SLAM may have stopped or jumped."""
        return {u for u, stream in enumerate(self.streams) if stream is not None and stream.suspect is not None}

    def state(self, user: int, suspected: frozenset[int]) -> tuple[State, str]:
        """Of a user at this moment, and why.

        `suspected`: whose latest ranges make it doubtful where they are; where the reference is, nobody is sure.
        """
        standing, stream = self.standings[user], self.streams[user]
        if user == self.reference and not standing.contradicted:
            if stream is not None and stream.suspect is not None:  # the others are where they were in the common frame
                return State.UNOBSERVABLE, _doubt_of(stream)
            return State.REGISTERED, "the reference: its frame is the common one"
        if standing.is_registered:
            if self.standings[self.reference].contradicted:
                return State.UNOBSERVABLE, "the reference's own track is contradicted"
            if stream is not None and stream.suspect is not None:
                return State.UNOBSERVABLE, _doubt_of(stream)
            if standing.unconfirmed_since is not None:
                return (
                    State.UNOBSERVABLE,
                    "its SLAM has paused: its next ranges tell whether its frame is still the same",
                )
            if standing.left_at is not None:
                return State.UNOBSERVABLE, "others were contradicted: its next ranges tell whether it is where it was"
            if not suspected.isdisjoint((user, self.reference)):
                return State.UNOBSERVABLE, "its latest ranges may say that it is somewhere else"
        return standing.state, standing.reason

    def device_now(self, user: int) -> Array | None:
        """(3,) m: where a user's device is in the common frame; None where that is not known."""
        stream, placed = self.streams[user], self.standings[user].placed
        last = None if stream is None else stream.last()
        if placed is None:
            if last is None or user != self.reference:
                return None
            return np.asarray(last.position[0] + np.array([0.0, 0.0, self.level_of(user)]))
        return placed.at(placed.place if last is None else last.position[0])

    def own_frame(self, user: int, placed: Placed) -> Array:
        """(4,) x, y, z, yaw: common_from_user of a placed user, for its newest poses."""
        x, y, yaw, height, log_scale = placed.state[:5].tolist()
        return self.frame_at(user, np.array([x, y, height, yaw]), log_scale, placed.place)

    def frame_at(self, user: int, place: Array, log_scale: float, at: Array) -> Array:
        """(4,) x, y, z, yaw: common_from_user of a user whose device is at `place` (4,), SLAM's `at` (3,) repaired."""
        stream = self.streams[user]
        turned, (x, y, z) = 0.0, at.tolist()
        if stream is not None:
            axes = stream.current_axes()
            turned = axes.yaw
            x, y, z = (at - axes.offset).tolist()
            z += self.level_of(user)
        scale, c, s = exp(log_scale), cos(place[3]), sin(place[3])
        arm = scale * np.array([c * x - s * y, s * x + c * y, z])
        return np.array([*(place[:3] - arm).tolist(), wrap_angle(float(place[3]) + turned)])

    # To and from plain values

    def to_state(self) -> dict[str, Any]:
        """All that it knows but for who the users are, as `restore` takes it."""
        streams = [None if stream is None else stream.state() for stream in self.streams]
        return kept(self) | {"streams": streams}

    def restore(self, state: Mapping[str, Any]) -> None:
        """What `to_state` told of the same users."""
        restore_kept(self, state)
        for u, of_user in enumerate(state["streams"]):
            self.streams[u] = None if of_user is None else PoseStream.from_state(self.parameters, of_user)


def _doubt_of(stream: PoseStream) -> str:
    """Why nobody can say where a device is whose newest poses are in doubt."""
    assert stream.suspect is not None
    return f"its SLAM may have {'stopped' if stream.suspect.kind == 'frozen' else 'jumped'}"
