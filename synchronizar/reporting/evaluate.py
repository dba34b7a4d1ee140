"""Errors of tracks in a common frame against the truth.

The common frame's origin and heading are free, so estimates are aligned to the truth by one yaw and one translation:
the closed form of Umeyama (Least-squares estimation of transformation parameters between two point patterns, IEEE
Trans. PAMI 13(4), 1991, eq. 40 to 42) in the plane, without scale, with weights. Heights are aligned by their mean.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.track import Track
from synchronizar.errors import InputError, os_faults
from synchronizar.geometry import YawFrame, frame_between, wrap_angle
from synchronizar.io.recording_toml import Settings, read_recording_toml
from synchronizar.io.registration_reader import read_reference
from synchronizar.io.tum import read_tum

MAX_GAP_S = 0.5
"""s: the truth is not interpolated over longer gaps."""
MOVED_M = 0.5
"""m: the positions of a device that moved less do not determine its heading."""


@dataclass(frozen=True)
class Evaluation:
    """Errors of all users: RMSE in m, in space and (`_xy`) in the plane; None where nothing can be compared.

    The dictionaries hold every user with both an estimate and truth, except the reference.
    """

    reference: str | None
    """None where the tracks are in a survey's frame, which is the truth's: `transfer` needs no alignment then."""
    joint_ate: float | None
    """After one alignment of all users together; every user has the same weight."""
    joint_ate_xy: float | None
    reference_ate: float | None
    """Of the reference after its own alignment."""
    reference_ate_xy: float | None
    transfer: Mapping[str, float | None]
    """Of each other user after the reference's alignment; None where the reference has no truth or did not move. In a
    survey's frame of everybody, as it is."""
    transfer_xy: Mapping[str, float | None]
    yaw: Mapping[str, float | None]
    """rad: yaw from a user's track to its truth aligned by the reference; None also where the truth did not move."""
    missing: tuple[str, ...]
    """Users with truth that have no estimate at any time of it."""


@dataclass(frozen=True)
class Matched:
    """Positions of one user at the same n times: (n, 3) m in the common frame, and (n, 3) m in the truth's."""

    estimated: Array
    true: Array

    @property
    def moved(self) -> bool:
        """Whether the truth moved far enough to determine a heading."""
        return float(np.linalg.norm(np.ptp(self.true, axis=0))) >= MOVED_M


def evaluate(estimated: Mapping[str, Track], truth: Mapping[str, Track], reference: str | None) -> Evaluation:
    """Errors of tracks in one common frame, at the estimates' stamps that the truth covers.

    Truth that is sparser than it may be interpolated is compared at its own stamps. A track of one pose is a static
    device and holds at all times. `reference` None: the common frame is the truth's own.
    """
    users = {}
    for name in sorted(truth):
        matched = match(estimated[name], truth[name]) if name in estimated else None
        if matched is not None:
            users[name] = matched
    missing = tuple(name for name in sorted(truth) if name not in users)

    joint = joint_xy = reference_ate = reference_ate_xy = None
    if users:
        world_from_common = align(list(users.values()))
        errors = np.array([_rmse(world_from_common, matched) for matched in users.values()])
        joint, joint_xy = np.sqrt(np.mean(errors**2, axis=0)).tolist()

    others = {name: matched for name, matched in users.items() if name != reference}
    transfer: dict[str, float | None] = dict.fromkeys(others)
    transfer_xy, yaw = transfer.copy(), transfer.copy()
    if reference is None or reference in users:
        world_from_common = YawFrame()
        if reference is not None:
            world_from_common = align([users[reference]])
            reference_ate, reference_ate_xy = _rmse(world_from_common, users[reference])
        if reference is None or users[reference].moved:
            for name, matched in others.items():
                transfer[name], transfer_xy[name] = _rmse(world_from_common, matched)
                if matched.moved:
                    yaw[name] = wrap_angle(align([matched]).yaw - world_from_common.yaw)
    return Evaluation(reference, joint, joint_xy, reference_ate, reference_ate_xy, transfer, transfer_xy, yaw, missing)


def evaluate_folder(recording: Path, out: Path) -> Evaluation:
    """Errors of the tracks in `out` against the truth in a recording's folder.

    The reference is the one in out/registration.json, else the first by name whose truth moves. Raises
    InputError where there is no truth, no folder `out`, or a file that cannot be used.
    """
    settings = recording / "recording.toml"
    told = read_recording_toml(settings) if settings.exists() else Settings()
    truth = read_tracks(recording / "truth", told, "errors are told where a recording has truth/<user>.tum")
    if not truth:
        raise InputError(recording / "truth", "holds no truth to compare with")
    own = read_tracks(out, remedy=f"`synchronizar register {recording} --out {out}` writes it")
    return evaluate(own, truth, _reference(out / "registration.json", truth))


def evaluation_json(e: Evaluation) -> dict[str, object]:
    """The object that `evaluate --json` prints."""
    return {
        "joint_ate": e.joint_ate,
        "joint_ate_xy": e.joint_ate_xy,
        "reference_ate": e.reference_ate,
        "reference_ate_xy": e.reference_ate_xy,
        "transfer": dict(e.transfer),
        "transfer_xy": dict(e.transfer_xy),
        "yaw": dict(e.yaw),
        "missing": list(e.missing),
    }


def read_tracks(folder: Path, settings: Settings | None = None, remedy: str = "") -> dict[str, Track]:
    """Tracks of a folder by file name, z up; hidden files are not tracks.

    `settings` give the vertical axis of the files' own frames; without them it is z.
    Raises InputError, with the remedy, where there is no such folder.
    """
    settings = settings or Settings()
    up = {name: user.up for name, user in settings.users.items()}
    with os_faults(folder, remedy):
        files = sorted(file for file in folder.iterdir() if file.suffix == ".tum" and not file.name.startswith("."))
    return {file.stem: read_tum(file, up.get(file.stem, settings.up)) for file in files}


def _reference(path: Path, truth: Mapping[str, Track]) -> str | None:
    """The reference that a registration.json names, None for a survey.

    Without one the first by name whose truth moves.
    """
    named = read_reference(path) if path.exists() else None
    if named is not None:
        return None if named.is_survey else named.name
    return next((name for name, track in truth.items() if track.extent() >= MOVED_M), next(iter(truth)))


def match(estimated: Track, truth: Track) -> Matched | None:
    """Positions of estimate and truth at the same times; None where no time is in both."""
    if len(truth) == 1:
        return Matched(estimated.position, np.broadcast_to(truth.position, estimated.position.shape))
    if len(estimated) == 1:
        return Matched(np.broadcast_to(estimated.position, truth.position.shape), truth.position)
    if float(np.median(np.diff(truth.t))) > MAX_GAP_S:
        poses = estimated.at(truth.t, MAX_GAP_S)
        known = poses.valid
        return Matched(poses.position[known], truth.position[known]) if known.any() else None
    poses = truth.at(estimated.t, MAX_GAP_S)
    if not poses.valid.any():
        return None
    return Matched(estimated.position[poses.valid], poses.position[poses.valid])


def align(users: list[Matched]) -> YawFrame:
    """`world_from_common` by least squares over all positions, the scale fixed; every user has the same weight."""
    estimated = np.concatenate([m.estimated for m in users])
    true = np.concatenate([m.true for m in users])
    weight = np.concatenate([np.full(len(m.true), 1.0 / len(m.true)) for m in users]) / len(users)
    return frame_between(true, estimated, weight)


def _rmse(world_from_common: YawFrame, matched: Matched) -> tuple[float, float]:
    """RMSE (m) in space and in the plane."""
    squares = (world_from_common @ matched.estimated - matched.true) ** 2
    return float(np.sqrt(squares.sum(axis=1).mean())), float(np.sqrt(squares[:, :2].sum(axis=1).mean()))
