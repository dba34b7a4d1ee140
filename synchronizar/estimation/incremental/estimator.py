"""Registration while people walk, by names: poses and ranges in, the batch solve's own types out at any moment."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from synchronizar.arrays import Array
from synchronizar.data.ranges import SOURCES
from synchronizar.data.registration import RangeVerdicts, Registration, State, UserRegistration
from synchronizar.data.survey import SURVEY, survey_origin
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.estimation.incremental.engine import Engine
from synchronizar.estimation.incremental.state_file import load, save
from synchronizar.estimation.incremental.told import NewestRange, newest_ranges, registration_now
from synchronizar.geometry import Up, YawFrame
from synchronizar.parameters import Parameters

_SETTINGS = (
    *("static", "height_sigma", "position", "position_sigma", "range_bias", "range_bias_sigma"),
    *("antennas", "up"),
)
_NUMBERS = ("sigma", "rx_power", "fp_power", "nlos")
_SURVEYED = "radios were surveyed: the common frame is the survey's"
_NOBODY_MOVED = "nobody has moved far enough yet to be the reference"


class Estimator:
    """Everybody's frame while poses and ranges come.

    Poses and ranges are added as they come, in any order; `advance` says what time it is and goes on with what is to be
    solved; `registration` tells what is known now. Users, antennas and sources are named as in recordings.
    """

    def __init__(
        self,
        users: Iterable[str] | Mapping[str, Mapping[str, Any]],
        up: Up = "z",
        reference: str | None = None,
        parameters: Parameters | None = None,
        workers: int | None = None,
    ) -> None:
        """`users`: names, or settings by name as in recording.toml (static, up, height_sigma, position, antennas, ...).

        `up`: which axis points up in the poses of users whose settings do not say, "z" or "y". `reference`: whose frame
        the common one is; None: the first by name that moves more than 0.5 m. Where radios were surveyed (position)
        the common frame is the survey's, and there is no `reference` to choose. `workers`: 0 searches within `advance`,
        and is deterministic; 1 in a process of its own, so that nobody waits for it; None: 1 where there is more than
        one core. Raises ValueError naming the argument.
        """
        if workers not in (None, 0, 1):
            raise ValueError(f"workers: must be 0, 1 or None, not {workers!r}")
        self._workers = _usual_workers() if workers is None else int(workers)
        self._up: Up = up
        self._all = _users(users, up)
        """As the engine has them: the survey's origin is among them."""
        self.refused: Counter[str] = Counter()
        """How many poses and ranges were no measurement, by what was wrong with them; they are left out."""
        self._index = {user.name: u for u, user in enumerate(self._all)}
        """Where each user stands among all, by name."""
        self._parameters = parameters or Parameters()
        self._engine: Engine | None = None
        self._waiting: list[Callable[[Engine], None]] = []
        self._extent: dict[str, tuple[Array, Array]] = {}
        self._told: Counter[str] = Counter()
        self._news: list[str] = []
        origin = survey_origin(self._all)
        if origin is not None:
            if reference is not None:
                raise ValueError(f"reference: {_SURVEYED}")
            self._all = (*self._all, origin)
            self._begin(len(self._all) - 1)
        if reference is not None:
            if self._all[self._known("reference", reference)].static:
                raise ValueError(f"reference: {reference!r} is static: it has no heading for the common frame")
            self._begin(self._index[reference])

    @property
    def users(self) -> tuple[User, ...]:
        """Everybody, in the order in which they came."""
        return tuple(user for user in self._all if not user.is_survey_origin)

    @property
    def reference(self) -> str | None:
        """Whose frame the common one is, "survey" where radios were; None until somebody has moved far enough."""
        if self._engine is None:
            return None
        known = self._all[self._engine.reference]
        return SURVEY if known.is_survey_origin else known.name

    def add_pose(self, user: str, t: float, position: ArrayLike, quat_xyzw: ArrayLike) -> None:
        """A device's own pose: s by its own clock, (3,) m and (4,) x y z w in the axes of its own frame.

        Raises ValueError that names the argument for an unknown or static user, a wrong shape or type. A value that no
        device can mean (NaN, a zero quaternion) is refused: counted in `refused`, told by `advance`.
        """
        known_as = self._known("user", user)
        known = self._all[known_as]
        if known.static:
            raise ValueError(f"user: {user!r} is static: it has no poses")
        stamp = _number("t", t)
        place, quat = _vector("position", position, 3), _vector("quat_xyzw", quat_xyzw, 4)
        with np.errstate(over="ignore"):
            length = float(np.linalg.norm(quat))
        if not (np.isfinite(stamp) and np.isfinite(place).all() and np.isfinite(quat).all()):
            return self._refuse(f"{user}: a pose that is not finite")
        if not 0.0 < length < np.inf:
            return self._refuse(f"{user}: a quaternion of length {length:g}")
        quat /= length
        if known.up != "z":
            z_up = YawFrame(up_b=known.up)
            place, quat = z_up @ place, z_up.rotate_quaternions(quat)
        self._see(user, place)
        return self._do(lambda engine: engine.add_pose(known_as, stamp, place.tolist(), quat.tolist()))

    def add_range(
        self,
        t: float,
        a: str,
        b: str,
        distance: float | None,
        *,
        antenna_a: str | None = None,
        antenna_b: str | None = None,
        source: str | None = None,
        **optional: float | None,
    ) -> None:
        """A distance (m) between two users by the range clock (s).

        `optional`: sigma (m), rx_power, fp_power (dBm) and nlos (0 or 1), None where unknown; `source`: one of SOURCES.
        Raises ValueError that names the argument for an unknown user or antenna, column or type. A value that no radio
        can mean (None, NaN, a range to oneself, a sigma that is not positive) is refused, counted and told.
        """
        ends = [self._known(argument, name) for argument, name in (("a", a), ("b", b))]
        if unknown := optional.keys() - set(_NUMBERS):
            raise ValueError(f"{min(unknown)}: there is no such column; there are {', '.join(_NUMBERS)}")
        if source is not None and source not in SOURCES:
            raise ValueError(f"source: {source!r} is none of {', '.join(SOURCES)}")
        stamp = _number("t", t)
        measured = np.nan if distance is None else _number("distance", distance)
        columns = {name: _number(name, value) for name, value in optional.items() if value is not None}
        columns = {name: value for name, value in columns.items() if not np.isnan(value)}
        for end, which, antenna in (("antenna_a", ends[0], antenna_a), ("antenna_b", ends[1], antenna_b)):
            columns[end] = _antenna(end, self._all[which], antenna)
        if a == b:
            return self._refuse(f"{a}: a range to itself")
        if not np.isfinite([stamp, measured]).all():
            return self._refuse(f"{a} and {b}: a range that is no number")
        if not 0.0 < columns.get("sigma", 1.0) < np.inf:
            return self._refuse(f"{a} and {b}: a sigma that is not positive")
        if columns.get("nlos", 0.0) not in (0.0, 1.0):
            return self._refuse(f"{a} and {b}: an nlos that is neither 0 nor 1")
        return self._do(lambda engine: engine.add_range(stamp, ends[0], ends[1], measured, **columns))

    def add_user(self, name: str, **settings: Any) -> None:
        """One more user, with settings as in recording.toml.

        With the first radio that was surveyed the common frame becomes the survey's, and everybody is looked for anew.
        Raises ValueError for a name that is there already, or a setting that is none.
        """
        if name in self._index:
            raise ValueError(f"name: there is a user {name!r} already")
        (user,) = _known_users({name: settings}, self._up)
        self._index[name] = len(self._all)
        self._all = (*self._all, user)
        if user.position is not None and not any(known.is_survey_origin for known in self._all):
            self._begin_survey()
        elif self._engine is not None:
            self._engine.add_user(user)

    def _begin_survey(self) -> None:
        """The first surveyed radio has come."""
        origin = survey_origin(self._all)
        assert origin is not None
        self._all = (*self._all, origin)
        if self._engine is not None:
            self._engine.close()
            self._news.append(f"{_SURVEYED} from now on: everybody is looked for anew")
        self._begin(len(self._all) - 1)

    def lost_tracking(self, user: str) -> None:
        """A device says that its SLAM lost track: the user is not registered until it is found anew.

        What its poses tell from now on need not continue what they told before. Raises ValueError for an unknown user.
        """
        known_as = self._moving(user)
        self._do(lambda engine: engine.lost_tracking(known_as))

    def new_session(self, user: str) -> None:
        """A device says that its SLAM began anew, in another frame: it is looked for anew.

        Raises ValueError for an unknown user.
        """
        known_as = self._moving(user)
        self._do(lambda engine: engine.new_session(known_as))

    def _moving(self, user: str) -> int:
        """The index of a user who has SLAM."""
        known_as = self._known("user", user)
        if self._all[known_as].static:
            raise ValueError(f"user: {user!r} is static: it has no SLAM")
        return known_as

    def advance(self, t: float) -> list[str]:
        """It is `t` (s, range clock): go on with what is to be solved. Returns what has happened, a sentence each.

        To be called ten times a second or more often.
        """
        now = _number("t", t)
        if not np.isfinite(now):
            raise ValueError(f"t: {t!r} is no time")
        if self._engine is None and (moved := self._moved()) is not None:
            self._begin(self._index[moved])
        events, self._news = self._news, []
        events += self._engine.advance(now) if self._engine is not None else []
        news = self.refused - self._told
        self._told = self.refused.copy()
        return [*events, *(f"{what}: refused, {count} time{'s' * (count > 1)}" for what, count in sorted(news.items()))]

    def complete(self, t: float) -> list[str]:
        """As `advance`, where nothing more will come: searches once more in all that has come."""
        events = self.advance(t)
        return [*events, *(self._engine.complete(float(t)) if self._engine is not None else [])]

    def registration(self) -> Registration:
        """What is known now, as `register` tells it: frames at each user's last pose, states, progress and cues.

        `ranges` are those of the recent past, by time. Never raises: before anything is solved every
        user is listed, disconnected, its transform None.
        """
        if self._engine is not None:
            return registration_now(self._engine)
        nothing = {user.name: _disconnected(user, _NOBODY_MOVED) for user in self.users}
        return Registration(None, "full", "joint", nothing, (), _no_ranges(), _no_seconds())

    def newest_ranges(self) -> tuple[NewestRange, ...]:
        """The newest range of each pair in the recent past, with its residual where it was compared."""
        return () if self._engine is None else newest_ranges(self._engine)

    def close(self) -> None:
        """End the process that searches; the next search would begin another one."""
        if self._engine is not None:
            self._engine.close()

    def save(self, path: str | Path) -> None:
        """Write all that it knows to a file. Raises InputError where that cannot be, or there is nothing yet."""
        if self._engine is None:
            raise InputError(path, f"there is nothing to save: {_NOBODY_MOVED}")
        save(self._engine, path, {"up": self._up, "refused": dict(self.refused), "told": dict(self._told)})

    @classmethod
    def load(cls, path: str | Path, parameters: Parameters | None = None, workers: int | None = None) -> Estimator:
        """Go on from a file that `save` wrote, and say what the saved one said. Raises InputError where it is none."""
        engine, face = load(path, parameters or Parameters(), _usual_workers() if workers is None else workers)
        settings = {user.name: _settings(user) for user in engine.users if not user.is_survey_origin}
        out = cls(settings, up=face["up"], parameters=parameters, workers=workers)
        out._all, out.refused, out._told = engine.users, Counter(face["refused"]), Counter(face["told"])
        out._index = {user.name: u for u, user in enumerate(out._all) if not user.is_survey_origin}
        out._engine = engine
        return out

    def _known(self, argument: str, name: str) -> int:
        if not isinstance(name, str) or name not in self._index:
            raise ValueError(f"{argument}: there is no user {name!r}; there are {', '.join(self._index)}")
        return self._index[name]

    def _refuse(self, what: str) -> None:
        self.refused[what] += 1

    def _do(self, call: Callable[[Engine], None]) -> None:
        if self._engine is None:
            self._waiting.append(call)
        else:
            call(self._engine)

    def _begin(self, reference: int) -> None:
        self._engine = Engine(self._all, reference, self._parameters, self._workers)
        waiting, self._waiting = self._waiting, []
        for call in waiting:
            call(self._engine)

    def _see(self, user: str, place: Array) -> None:
        """How far each user has come, until the reference is chosen."""
        if self._engine is None:
            low, high = self._extent.get(user, (place, place))
            self._extent[user] = np.minimum(low, place), np.maximum(high, place)

    def _moved(self) -> str | None:
        least = self._parameters.priors.least_extent
        return min((u for u, (low, high) in self._extent.items() if np.linalg.norm(high - low) > least), default=None)


def _usual_workers() -> int:
    return 1 if (os.cpu_count() or 1) > 1 else 0


def _users(users: Iterable[str] | Mapping[str, Mapping[str, Any]], up: Up) -> tuple[User, ...]:
    """By name; raises ValueError that names the argument."""
    out = _known_users(users, up)
    if all(user.static for user in out):
        raise ValueError("users: somebody must move to have a frame")
    return tuple(sorted(out, key=lambda user: user.name))


def _known_users(users: Iterable[str] | Mapping[str, Mapping[str, Any]], up: Up) -> list[User]:
    if isinstance(users, str):
        raise ValueError("users: must be several names, not one string")
    if up not in ("y", "z"):
        raise ValueError(f'up: must be "z" or "y", not {up!r}')
    settings = users if isinstance(users, Mapping) else {name: {} for name in users}
    out = []
    for name in settings:
        if not isinstance(name, str):
            raise ValueError(f"users: {name!r} is no name")
        if unknown := settings[name].keys() - set(_SETTINGS):
            raise ValueError(f"users: {name!r} has no setting {min(unknown)!r}; there are {', '.join(_SETTINGS)}")
        own: dict[str, Any] = {"up": up} | dict(settings[name])
        own["antennas"] = {k: _lever(name, k, lever) for k, lever in dict(own.get("antennas", {})).items()}
        if own.get("position") is not None:
            x, y, z = _vector(f"users: position of {name!r}", own["position"], 3).tolist()
            own["position"] = (x, y, z)
        if own.get("position_sigma") == 0.0:
            raise ValueError(f"users: {name!r}: a position_sigma must be positive")
        if own["up"] not in ("y", "z"):
            raise ValueError(f'users: {name!r} has up {own["up"]!r}; it must be "z" or "y"')
        try:
            out.append(User(name, **own))
        except (TypeError, ValueError) as error:
            raise ValueError(f"users: {name!r}: {error}") from None
    return out


def _settings(user: User) -> dict[str, Any]:
    return {name: getattr(user, name) for name in _SETTINGS}


def _lever(user: str, antenna: str, lever: ArrayLike) -> tuple[float, float, float]:
    x, y, z = _vector(f"users: antenna {antenna!r} of {user!r}", lever, 3).tolist()
    return x, y, z


def _number(argument: str, value: object) -> float:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise ValueError(f"{argument}: {value!r} is no number") from None


def _vector(argument: str, values: ArrayLike, n: int) -> Array:
    try:
        out = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{argument}: must be {n} numbers") from None
    if out.shape != (n,):
        raise ValueError(f"{argument}: must have shape ({n},), not {out.shape}")
    return out


def _antenna(argument: str, user: User, name: str | None) -> int:
    """Its index; the only one need not be named; -1 for users that declare none."""
    names: Sequence[str] = list(user.antennas)
    if not names:
        return -1
    if name is None and len(names) == 1:
        return 0
    if name not in names:
        raise ValueError(f"{argument}: {user.name} has the antennas {', '.join(names)}, not {name!r}")
    return names.index(name)


def _disconnected(user: User, reason: str) -> UserRegistration:
    return UserRegistration(user.name, State.DISCONNECTED, reason, None, None, user.static, progress=0.0)


def _no_ranges() -> RangeVerdicts:
    none = np.zeros(0, dtype=bool)
    return RangeVerdicts(none, none.copy(), np.zeros(0), np.zeros(0))


def _no_seconds() -> dict[str, float]:
    return {"load": 0.0, "initialise": 0.0, "solve": 0.0}
