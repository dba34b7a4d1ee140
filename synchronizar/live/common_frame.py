"""Where everybody's frame lies in the common one, as the solver knows it, and when that is told."""

from __future__ import annotations

import numpy as np

from synchronizar.geometry import YawFrame
from synchronizar.live import messages as m
from synchronizar.live.doubts import Doubts
from synchronizar.live.member import Device
from synchronizar.live.peer_placing import placed, told_frame
from synchronizar.live.people import People
from synchronizar.live.sleeping import Standing, standing_of
from synchronizar.live.solver_wire import NewestRange, Told

FRAMES_AT_LEAST_EVERY = 0.5
"""s between frames that are told though nothing has changed."""
MOVES_EVERY = 0.19
"""s between frames that are told because somebody's place changed, and nothing else."""
_CHANGED_M, _CHANGED_RAD = 1e-3, 2e-4


class CommonFrame:
    """What the solver said last of one room."""

    def __init__(self, t: float, people: People) -> None:
        self.now = m.Frames(0, t, None, {})
        self.ranges: list[NewestRange] = []
        self.known_at = -np.inf
        """s: of when it is."""
        self._people = people
        self._doubts = Doubts()
        self._untold = False
        self._frames_at = -np.inf

    def hear(self, told: Told) -> None:
        """What the solver knows now: told to everybody where it is news."""
        self.known_at, self.ranges = told.t, told.ranges
        if told.events:
            self._people.tell(m.Events(told.t, told.events))
        news, moved = _is_news(self.now, told), _moved(self.now, told)
        self.now = m.Frames(self.now.version + (news or moved), told.t, told.reference, told.users)
        self._untold = self._untold or moved
        since = told.t - self._frames_at
        if news or (self._untold and since >= MOVES_EVERY) or not 0.0 <= since < FRAMES_AT_LEAST_EVERY:
            self._frames_at, self._untold = told.t, False
            self._people.tell_latest("frames", self.now)

    def frame_of(self, name: str) -> YawFrame | None:
        """`common_from_user` of a device's present SLAM frame, in its own axes; None: not known."""
        device = self._people.devices.get(name)
        if device is None:
            return None
        return told_frame(self.now.users.get(name), device.settings.up, device.frame)

    def told_of(self, device: Device) -> m.UserFrame | None:
        """What is told of a device's present SLAM frame; None where it is not known where that lies."""
        told = self.now.users.get(device.name)
        return None if told is None or told.matrix is None or told.frame != device.frame else told

    def in_common(self, name: str, position: m.Vector, quat: m.Quaternion) -> tuple[m.Vector, m.Quaternion] | None:
        """A pose in a device's own axes, in the common frame; None while it is not registered."""
        told = self.now.users.get(name)
        frame = self.frame_of(name)
        if told is None or told.state != "registered" or frame is None:
            return None
        return placed(frame, position, quat)

    def standings(self) -> dict[str, Standing]:
        """How those stand who are here; who is doubted is so once, when what was told of them was contradicted."""
        standings = {}
        for device in self._people.devices.values():
            told = self.now.users.get(device.name)
            if device.client is None and not device.settings.static:
                continue
            if told is None or told.frame != device.frame:
                standings[device.name] = Standing(registered=False, sigma=np.inf)
            else:
                doubted = self._doubts.look(self.now.t, device, told)
                standings[device.name] = standing_of(told.state, told.sigma, doubted)
        self._doubts.keep(standings)
        return standings


def _is_news(before: m.Frames, told: Told) -> bool:
    """Whether anything is another one that is no number."""
    if before.reference != told.reference or before.users.keys() != told.users.keys():
        return True
    return any(_kind(before.users[name]) != _kind(now) for name, now in told.users.items())


def _kind(user: m.UserFrame) -> tuple[str, int, str | None, bool]:
    return user.state, user.frame, user.cue, user.matrix is None


def _moved(before: m.Frames, told: Told) -> bool:
    """Whether anybody's frame lies elsewhere."""
    for name, now in told.users.items():
        was = before.users.get(name)
        if was is None or now.matrix is None:
            continue
        moved = [(a or 0.0) - (b or 0.0) for a, b in zip((was.x, was.y, was.z), (now.x, now.y, now.z), strict=True)]
        if max(map(abs, moved)) > _CHANGED_M or abs((was.yaw or 0.0) - (now.yaw or 0.0)) > _CHANGED_RAD:
            return True
    return False
