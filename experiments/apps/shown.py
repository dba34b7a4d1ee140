"""What pages have shown of an application's things, frame by frame, beside the truth and beside one another.

A page shows a thing in place where who holds the phone sees it at the right spot of the real room: so a place of the
common frame is brought to the room by where the phone is in truth and where the page thinks that it is, by its own
SLAM's pose and where it has put the common frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from synchronizar.apps.catch.flight import Flight
from synchronizar.arrays import Array
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.live.stage import Player
from synchronizar.quaternions import yaw_of_quaternions
from synchronizar.simulation.simulate import Simulation

FRAME_S = 1.0 / 60.0
NEAR_S = 0.03
"""s: frames of two pages that are so near are compared."""
LONGEST_S = 0.25
"""s: after a longer pause between two frames nobody sees a step."""
SETTLED_S = 0.5
"""s of drawing after which a ball that has changed hands has glided to its place."""
LONGEST_GLIDE_S = 0.2
"""s that a thing glides at most between two frames, however far they are apart."""

# With each frame: [s of the phone's pose by the wall, the room's time and what it is off, where the common frame is,
# whether that is sure, {id: place}, what the ball does, {name: of when somebody is shown}].
LOG = """(what) => {
  const { app, avatars, client, frame } = synchronizar;
  globalThis.drawn = [];
  let wall = null;
  const [sendPose, update] = [client.sendPose, app.update];
  client.sendPose = (position, quat, t) => {
    wall = t;
    sendPose.call(client, position, quat, t);
  };
  app.update = (dt, roomTime) => {
    update.call(app, dt, roomTime);
    if (!frame.placing || wall === null || roomTime === null) return;
    const { x, y, z, yaw, scale } = frame.placing;
    const others = avatars.places;
    const things =
      what === "robot" ? (others.robot ? { robot: others.robot.position } : {})
      : what === "treasure" ? app.places
      : app.at ? { ball: app.at } : {};
    const shown = Object.fromEntries(Object.entries(others).map(([name, { t }]) => [name, t]));
    const ball = client.objects.get("catch ball")?.data ?? null;
    const sure = frame.registered && frame.opacity === 1;
    // Not by `roomTime`: on a busy machine that was asked for a while ago.
    const early = client.roomTime - (performance.timeOrigin + performance.now()) / 1000;
    drawn.push([wall, roomTime, early, [x, y, z, yaw, scale], sure, things, ball, shown]);
  };
}"""


class Frame(NamedTuple):
    """One of a page."""

    wall: float
    """s since 1970: of the phone's pose with which it was drawn."""
    t: float
    """s, by the room's clock, as the page knows it."""
    early: float
    """s: what the page takes for the room's time minus what that is."""
    placing: YawFrame
    """Where the page has put the common frame: `common_from_user`, z up."""
    sure: bool
    """Whether it says that the phone is in place."""
    things: dict[str, Array]
    """Where they are drawn, in the common frame."""
    ball: dict[str, Any] | None
    shown: dict[str, float]
    """s: of when each of the others is shown."""
    glided: float
    """s for which the page has drawn the ball since it first drew it like that, as it glides."""


def frames_of(rows: list[list[Any]]) -> list[Frame]:
    """Of what a page has noted."""
    out: list[Frame] = []
    for wall, t, early, placing, sure, things, ball, shown in rows:
        before = out[-1] if out else None
        same = before is not None and before.ball == ball
        glided = before.glided + min(wall - before.wall, LONGEST_GLIDE_S) if before is not None and same else 0.0
        places = {id_: np.array(place) for id_, place in things.items()}
        out.append(Frame(wall, t, early, YawFrame(*placing), sure, places, ball, shown, glided))
    return out


class Walker:
    """A phone, in truth and by its own SLAM."""

    def __init__(self, simulation: Simulation, name: str, began: float) -> None:
        """`began`: s since 1970, when the walk began."""
        self._own, self._true, self._began = simulation.recording.tracks[name], simulation.truth[name], began

    def in_room(self, frame: Frame, place: Array) -> Array:
        """Where in the real room somebody sees a place of the common frame that the page draws in that frame."""
        t = frame.wall - self._began
        own, true = _place(self._own, t), _place(self._true, t)
        turned = _yaw(self._true, t) - _yaw(self._own, t) - frame.placing.yaw
        return true + YawFrame(yaw=float(turned)) @ (place - frame.placing @ own)

    def hand(self, t: float) -> Array:
        """Where its hand is in truth, `t` s since 1970."""
        row = _row(self._true, t - self._began)
        x, y, z = _place(self._true, t - self._began).tolist()
        qx, qy, qz, qw = self._true.quat_xyzw[row].tolist()
        return np.array(Player("", (x, y, z), (qx, qy, qz, qw), "z").hand)


class Judged:
    """Numbers of one game; lengths in m."""

    def __init__(self, walkers: Mapping[str, Walker], pages: Mapping[str, list[list[Frame]]]) -> None:
        """`walkers`: everybody; `pages`: of each phone with a page what it drew, in pieces between its reloads."""
        self.walkers, self._pages = walkers, pages

    def frames(self) -> int:
        """How many were drawn while the page was sure."""
        return sum(frame.sure for pieces in self._pages.values() for piece in pieces for frame in piece)

    def swims(self, name: str | None = None, begin: float = -np.inf, end: float = np.inf) -> float:
        """The largest step in a 60th of a second, in the phone's own frame, of anything that stands.

        `name`: of that phone's page alone; `begin`, `end`: between these, s since 1970.
        """
        steps = [0.0]
        for pieces in self._pages.values() if name is None else [self._pages[name]]:
            for piece in pieces:
                for before, now in pairwise(piece):
                    dt = now.wall - before.wall
                    if not (before.sure and now.sure and 0.0 < dt < LONGEST_S and begin < now.wall < end):
                        continue
                    for place in now.things.values():
                        moved = now.placing.inverse() @ place - before.placing.inverse() @ place
                        steps.append(float(np.linalg.norm(moved)) * min(1.0, FRAME_S / dt))
        return max(steps)

    def off(self, truth: Any) -> list[float]:
        """In the plane, between where each thing is seen and `truth(id, frame)`; None: that is not known then."""
        out = []
        for name, frame in self._sure():
            for id_, place in frame.things.items():
                if (true := truth(id_, frame, name)) is not None:
                    out.append(float(np.linalg.norm((self.walkers[name].in_room(frame, place) - true)[:2])))
        return out

    def beside_one_another(self) -> list[float]:
        """Between where two pages show the same place at the same moment, in the plane."""
        out = []
        for one, other, a, b in self._pairs():
            for place in one.things.values():
                away = self.walkers[a].in_room(one, place) - self.walkers[b].in_room(other, place)
                out.append(float(np.linalg.norm(away[:2])))
        return out

    def arcs(self) -> list[float]:
        """Between the two balls that fly on two pages at the same moment, in the common frame."""
        out = []
        for one, other, _, _ in self._pairs():
            if one.ball is None or one.ball != other.ball or one.ball["phase"] != "flies":
                continue
            if min(one.glided, other.glided) < SETTLED_S or not ("ball" in one.things and "ball" in other.things):
                continue
            told = Flight(one.ball["t"], tuple(one.ball["position"]), tuple(one.ball["velocity"]))
            # Their frames are not of quite the same moment.
            off = [frame.things["ball"] - told.at(frame.t - frame.early) for frame in (one, other)]
            out.append(float(np.linalg.norm(off[0] - off[1])))
        return out

    def _sure(self) -> list[tuple[str, Frame]]:
        return [
            (name, frame) for name, pieces in self._pages.items() for piece in pieces for frame in piece if frame.sure
        ]

    def _pairs(self) -> list[tuple[Frame, Frame, str, str]]:
        """Frames of the first two pages that are of nearly the same moment."""
        a, b = list(self._pages)[:2]
        others = sorted((f for piece in self._pages[b] for f in piece if f.sure), key=lambda frame: frame.wall)
        walls = np.array([frame.wall for frame in others])
        out = []
        for frame in (f for piece in self._pages[a] for f in piece if f.sure):
            at = int(np.searchsorted(walls, frame.wall))
            near = [others[i] for i in (at - 1, at) if 0 <= i < len(others)]
            nearest = min(near, key=lambda other: abs(other.wall - frame.wall), default=None)
            if nearest is not None and abs(nearest.wall - frame.wall) < NEAR_S:
                out.append((frame, nearest, a, b))
        return out


def p95(values: list[float]) -> float:
    """NaN where there are none."""
    return float(np.percentile(values, 95)) if values else float("nan")


def _row(track: Track, t: float) -> int:
    return int(np.searchsorted(track.t, t).clip(0, len(track.t) - 1))


def _place(track: Track, t: float) -> Array:
    return np.array([np.interp(t, track.t, axis) for axis in track.position.T])


def _yaw(track: Track, t: float) -> float:
    """Between the poses about `t`, the short way round."""
    after = max(1, _row(track, t))
    yaws = yaw_of_quaternions(track.quat_xyzw[after - 1 : after + 1])
    share = float(np.clip((t - track.t[after - 1]) / (track.t[after] - track.t[after - 1]), 0.0, 1.0))
    return float(yaws[0] + share * wrap_angle(yaws[1] - yaws[0]))
