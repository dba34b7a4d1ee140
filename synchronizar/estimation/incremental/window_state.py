"""What incremental registration remembers from one solve to the next; can be written to a file and read again."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.data.user import User
from synchronizar.errors import InputError, os_faults
from synchronizar.estimation.incremental.stream import Stream
from synchronizar.geometry import moved_frames, rotation_2d
from synchronizar.graph.marginal_prior import MarginalPrior

_FORMAT = 3
_OF_CHECKPOINT = ("begin", "axes", "lift", "common", "spread")
_MALFORMED = (ValueError, KeyError, TypeError, AttributeError, EOFError, BadZipFile)


@dataclass(frozen=True)
class Checkpoint:
    """A moment that everything up to then was solved for; windows begin there."""

    t: float
    """s, range clock; minus infinity before the first range."""
    begin: Array
    """(k,) s, own stamps of each user's last pose then."""
    axes: Array
    """(k, 4) quaternions: what SLAM's axes had been turned by, to undo its jumps."""
    lift: Array
    """(k,) SLAM's lengths: what had been added to its heights, to the same end."""
    marginal_prior: MarginalPrior | None = None
    """None at the very begin."""
    common: Array = field(default_factory=lambda: np.zeros(4))
    """(4,) x, y, z, yaw: where the anchor of the user lies in the common frame beside which others are carried."""

    spread: Array = field(default_factory=lambda: np.zeros((4, 4)))
    """(4, 4) covariance of `common`: the user it is has drifted since the common frame was laid at its first pose."""

    def spread_at(self, place: Array) -> Array:
        """(k, 4, 4): what that makes the covariances of x, y, z, yaw of frames `place` (k, 4) in the common frame."""
        moves = np.tile(np.eye(4), (len(place), 1, 1))
        moves[:, 0, 3], moves[:, 1, 3] = self.common[1] - place[:, 1], place[:, 0] - self.common[0]
        return np.asarray(moves @ self.spread @ moves.transpose(0, 2, 1))

    def has(self, user: int) -> bool:
        """Whether a user is carried."""
        return self.marginal_prior is not None and user in self.marginal_prior.users

    def beside(self, user: int) -> Checkpoint:
        """The same, told beside another user that is carried."""
        assert self.marginal_prior is not None
        common = moved_frames(self.common, self.marginal_prior.frames)[[user]]
        at = 4 * self.marginal_prior.free.index(user) + np.array([0, 1, 3, 2])
        turn = np.eye(4)
        turn[:2, :2] = rotation_2d(float(self.common[3]))
        spread = self.spread_at(common)[0] + turn @ self.marginal_prior.covariance[np.ix_(at, at)] @ turn.T
        return replace(self, marginal_prior=self.marginal_prior.beside(user), common=common[0], spread=spread)


@dataclass
class Memory:
    """All that is not poses and ranges."""

    reference: int
    """Whose frame the common one is."""
    gauge: int
    """Whose last pose at a checkpoint everybody is told about: the reference, or who took its place."""
    checkpoints: list[Checkpoint]
    """By time; the first is where the window begins."""
    known: set[int]
    """Users whose place is believed."""
    noise: Array
    """(k, 2) how many times as far as the model says each SLAM drifts, in place and in heading."""
    since: dict[int, float] = field(default_factory=dict)
    """s: each user's first range since it came."""
    states: dict[int, State] = field(default_factory=dict)
    steady: dict[int, float] = field(default_factory=dict)
    """s: since when who is watched has stayed in its place,"""
    registered: dict[int, float] = field(default_factory=dict)
    """and since when who is registered has been so."""
    range_weight: float = 1.0
    """As how many independent ranges each counted on average."""
    now: float = -np.inf
    solved: float = -np.inf
    """s: when it was solved last."""
    seen: int = 0
    """How many ranges had come then."""

    @property
    def begin(self) -> Checkpoint:
        """Where the window begins."""
        return self.checkpoints[0]


def beginning(users: int, reference: int) -> Memory:
    """Before anything came."""
    identity = np.tile([0.0, 0.0, 0.0, 1.0], (users, 1))
    first = Checkpoint(-np.inf, np.full(users, -np.inf), identity, np.zeros(users))
    return Memory(reference, reference, [first], {reference}, np.ones((users, 2)))


def save(path: str | Path, stream: Stream, memory: Memory) -> None:
    """Write everything to a file. Raises InputError where that cannot be."""
    arrays: dict[str, Array] = {"noise": memory.noise}
    arrays |= {f"poses {n}": table for n, table in enumerate(stream.pose_tables())}
    arrays["ranges"] = stream.range_table()
    said = []
    for n, checkpoint in enumerate(memory.checkpoints):
        arrays |= {f"{name} {n}": getattr(checkpoint, name) for name in _OF_CHECKPOINT}
        marginal_prior = checkpoint.marginal_prior
        if marginal_prior is not None:
            arrays |= {f"{name} {n}": getattr(marginal_prior, name) for name in ("frames", "calibration", "covariance")}
        said.append(
            [checkpoint.t, None if marginal_prior is None else [marginal_prior.users, marginal_prior.reference]]
        )
    header = {
        "format": _FORMAT,
        "users": [
            [u.name, u.static, u.height_sigma, {k: list(v) for k, v in u.antennas.items()}, u.up] for u in stream.users
        ],
        "stream": [stream.added, stream.faults],
        "checkpoints": said,
        "known": sorted(memory.known),
        **{name: sorted(getattr(memory, name).items()) for name in _TIMES},
        "states": sorted((u, str(state)) for u, state in memory.states.items()),
        "numbers": [getattr(memory, name) for name in _NUMBERS],
    }
    file = Path(path)
    with os_faults(file), file.open("wb") as out:
        np.savez(out, header=np.array(json.dumps(header)), **arrays)  # type: ignore[arg-type]


_TIMES = ("since", "steady", "registered")
_NUMBERS = ("reference", "gauge", "range_weight", "now", "solved", "seen")


def load(path: str | Path) -> tuple[Stream, Memory]:
    """Read what `save` wrote. Raises InputError where the file is none of its kind."""
    file = Path(path)
    with os_faults(file):
        try:
            with np.load(file, allow_pickle=False) as arrays:
                return _read({name: arrays[name] for name in arrays.files})
        except _MALFORMED as error:
            raise InputError(file, "is no saved state") from error


def _read(arrays: dict[str, Any]) -> tuple[Stream, Memory]:
    header = json.loads(str(arrays["header"]))
    if header["format"] != _FORMAT:
        raise ValueError(header["format"])
    users = tuple(
        User(name, static, height_sigma, {k: tuple(v) for k, v in antennas.items()}, up)
        for name, static, height_sigma, antennas, up in header["users"]
    )
    stream = Stream(users)
    added, faults = header["stream"]
    stream.restore([arrays[f"poses {n}"] for n in range(len(users))], arrays["ranges"], added, faults)
    checkpoints = []
    for n, (t, told) in enumerate(header["checkpoints"]):
        begin, axes, lift, common, spread = (arrays[f"{name} {n}"] for name in _OF_CHECKPOINT)
        marginal_prior = None
        if told is not None:
            marginal_prior = MarginalPrior(
                told[0], told[1], *(arrays[f"{name} {n}"] for name in ("frames", "calibration", "covariance"))
            )
        checkpoints.append(Checkpoint(t, begin, axes, lift, marginal_prior, common, spread))
    return stream, Memory(
        checkpoints=checkpoints,
        known=set(header["known"]),
        noise=arrays["noise"],
        states={u: State(state) for u, state in header["states"]},
        since=dict(header["since"]),
        steady=dict(header["steady"]),
        registered=dict(header["registered"]),
        **dict(zip(_NUMBERS, header["numbers"], strict=True)),
    )
