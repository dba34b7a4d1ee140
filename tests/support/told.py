"""An estimator that says what a test tells it to, and keeps what it is given."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from synchronizar.data.registration import RangeVerdicts, Registration, State, UserRegistration
from synchronizar.geometry import YawFrame

NO_RANGES = RangeVerdicts(np.zeros(0, dtype=bool), np.zeros(0, dtype=bool), np.zeros(0), np.zeros(0))


class Scripted:
    """`says(t)`: of each user its state and its frame at an update."""

    def __init__(self, says: Callable[[float], dict[str, tuple[State, YawFrame | None]]]) -> None:
        self.says = says
        self.reference = "phone0"
        self.now = 0.0
        self.given: list[tuple[Any, ...]] = []

    def add_pose(self, user: str, t: float, position: Any, _quat_xyzw: Any) -> None:
        self.given.append((user, t, *np.round(position, 9).tolist()))

    def add_range(self, t: float, a: str, b: str, distance: float, **optional: Any) -> None:
        self.given.append((a, b, t, distance, {name: value for name, value in optional.items() if value is not None}))

    def new_session(self, user: str) -> None:
        self.given.append(("new session", user))

    def advance(self, t: float) -> list[str]:
        self.now = t
        self.given.append(("advance", round(t, 9)))
        return [f"it is {t:.1f}"]

    def registration(self) -> Registration:
        users = {
            name: UserRegistration(name, state, "", frame, None if frame is None else 0.01 * np.eye(4))
            for name, (state, frame) in self.says(self.now).items()
        }
        return Registration("phone0", "full", "joint", users, (), NO_RANGES, {})
