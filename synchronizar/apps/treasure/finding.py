"""Where a game's frame lies in a room's: by radios that still stand there, or by a device that kept its frame."""

from __future__ import annotations

from itertools import combinations
from math import dist

import numpy as np

from synchronizar.apps.treasure.game_file import Game, KeptFrame
from synchronizar.geometry import YawFrame, frame_between
from synchronizar.live.messages import UserFrame, Vector
from synchronizar.live.peer_placing import told_frame
from synchronizar.live.stage import Stage

SURE_M = 0.15
"""m: a radio or device is used once it is known that well."""
FITS_M = 0.4
"""m: radios whose distances differ by more from those of then have been moved."""
APART_M = 1.0
"""m: radios that stand closer say nothing about which way round the game lies."""


def found(stage: Stage, game: Game, kept: set[str]) -> YawFrame | None:
    """`common_from_game`; None while that is not known. `kept`: devices that say that their SLAM's frame is as then.

    Two radios that stood still fix a heading and a place, since both frames are z up; one device's frame does alone.
    """
    for name in sorted(kept & game.frames.keys()):
        told = stage.frames.users.get(name)
        if (common_from_user := _sure_frame(told)) is not None:
            was = game.frames[name]
            return common_from_user @ YawFrame(was.x, was.y, was.z, was.yaw, was.scale).inverse()
    return _by_radios(radios_of(stage), game.radios)


def radios_of(stage: Stage) -> dict[str, Vector]:
    """Places (m, common frame) of radios that stand still and are known well."""
    placed = ((member, _sure_frame(stage.frames.users.get(member.name))) for member in stage.members.values())
    return {who.name: (frame.x, frame.y, frame.z) for who, frame in placed if who.static and frame is not None}


def frames_of(stage: Stage, game_from_common: YawFrame) -> dict[str, KeptFrame]:
    """Where devices' own frames lie in the game's."""
    out = {}
    for member in stage.members.values():
        common_from_user = _sure_frame(stage.frames.users.get(member.name))
        if not member.static and common_from_user is not None:
            frame = game_from_common @ common_from_user
            out[member.name] = KeptFrame(frame.x, frame.y, frame.z, frame.yaw, frame.scale)
    return out


def _sure_frame(told: UserFrame | None) -> YawFrame | None:
    """`common_from_user` between z-up axes, of who is registered and known well."""
    if told is None or told.state != "registered" or told.sigma is None or told.sigma >= SURE_M:
        return None
    return told_frame(told, "z", told.frame)


def _by_radios(now: dict[str, Vector], then: dict[str, Vector]) -> YawFrame | None:
    names = [name for name in sorted(now.keys() & then.keys()) if _agrees(name, now, then)]
    if len(names) < 2:
        return None
    here, there = (np.array([places[name] for name in names]) for places in (now, then))
    if max(dist(a[:2], b[:2]) for a, b in combinations(there, 2)) < APART_M:
        return None
    return frame_between(here, there, np.full(len(names), 1.0 / len(names)))


def _agrees(name: str, now: dict[str, Vector], then: dict[str, Vector]) -> bool:
    """Whether at least half of its distances to the others are as they were: who was moved agrees with nobody."""
    others = [other for other in now.keys() & then.keys() if other != name]
    fits = [abs(dist(now[name], now[other]) - dist(then[name], then[other])) < FITS_M for other in others]
    return 2 * sum(fits) >= len(fits) > 0
