"""Consistency of covariances: normalised squared errors of registered users' frames and calibrations.

`python -m experiments.accuracy.consistency [--seeds 50] [--recordings ../shared/recordings]`. Walks are drawn from the
default model: SLAM drifts by the model's figures at 1 m/s, scale, biases and clocks are as spread as its priors (own
and common part in quadrature), ranges have white noise. Of the users that are called registered, each
`common_from_user`'s error squared in units of its covariance (in x, y, yaw, and with z), and each device's scale, bias
and clock in units of its sigma, averaged over seeds: where covariances are right the average lies in the band that 95 %
of averages of as many chi squares lie in (Wilson and Hilferty 1931). The row `all` of a size averages its users, whose
errors hang together through the reference; its band is that of one user, so it is too wide rather than too narrow. The
row `joint` takes the errors of a walk's registered users as one vector with one covariance, which says how they hang
together: its squares are told per degree of freedom, 1 is right.

Of real recordings nobody knows the true frame of a device whose SLAM drifts. It is made here from the truth of its last
10 s: the reference's whole track is laid onto its truth as `evaluate` does, the user's last 10 s then tell by how much
its heading and last place are off, and the median ratio of true steps to SLAM's its true scale.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.common.full_oracle import common_from_world
from experiments.common.results import write_table
from experiments.common.walks import on_all_cores
from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration, State, UserRegistration
from synchronizar.data.track import Track
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.parameters import Parameters
from synchronizar.reporting.evaluate import Matched, align, match, read_tracks
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

LAST_S = 10.0
STEP_S = 2.0
LEAST_STEP_M = 0.3
DEGREES = {"x y yaw": 3, "x y z yaw": 4, "scale": 1, "bias": 1, "clock": 1}
CHI_SQUARE_95 = {1: 3.841, 2: 5.991, 3: 7.815, 4: 9.488}


class Task(NamedTuple):
    """One walk."""

    users: int
    seconds: float
    seed: int


class Squares(NamedTuple):
    """One user's normalised estimation errors squared."""

    task: Task
    user: str
    registered: bool
    squares: dict[str, float]
    users: int = 1
    """Whose errors it joins."""


JOINT = "joint"


def scene_of(task: Task) -> Scene:
    """A walk as the default model takes it."""
    m = Parameters()
    return Scene(
        users=task.users,
        seconds=task.seconds,
        seed=task.seed,
        sigma=m.ranges.sigma,
        drift_m_per_sqrt_s=float(np.hypot(m.slam.drift_m_per_sqrt_s, m.slam.drift_m_per_sqrt_m)),
        drift_rad_per_sqrt_s=float(np.hypot(m.slam.drift_rad_per_sqrt_s, m.slam.drift_rad_per_sqrt_m)),
        scale_sigma=float(np.hypot(m.devices.scale_sigma, m.devices.scale_common_sigma)),
        bias_sigma=float(np.hypot(m.devices.bias_sigma, m.devices.bias_common_sigma)),
        clock_offset_sigma=float(np.hypot(m.devices.clock_sigma, m.devices.clock_common_sigma)),
    )


def squares_of(task: Task) -> list[Squares]:
    """Of every user but the reference in one walk."""
    simulation = simulate(scene_of(task))
    registration = register(simulation.recording)
    to_common = common_from_world(simulation, registration.reference)
    out, errors = [], {}
    for n, (name, user) in enumerate(registration.users.items()):
        if name == registration.reference or user.common_from_user is None:
            continue
        world_from_user = simulation.world_from_user[name]
        e = _difference(user.common_from_user, to_common @ world_from_user)
        squares = {"x y yaw": _square(user, e, [0, 1, 3]), "x y z yaw": _square(user, e, [0, 1, 2, 3])}
        if user.calibration_sigma is not None and user.clock_offset is not None:
            sigma = user.calibration_sigma
            scale, clock = user.common_from_user.scale, user.clock_offset
            squares["scale"] = ((scale - world_from_user.scale) / sigma.scale) ** 2
            squares["bias"] = ((user.range_bias - simulation.range_bias[name]) / sigma.range_bias) ** 2
            squares["clock"] = ((clock - simulation.clock_offset[name]) / sigma.clock_offset) ** 2
        registered = user.state is State.REGISTERED
        out.append(Squares(task, name, registered, squares))
        if registered:
            errors[n] = e
    if errors:
        out.append(Squares(task, JOINT, True, _joint_squares(registration, errors), len(errors)))
    return out


def _joint_squares(registration: Registration, errors: dict[int, Array]) -> dict[str, float]:
    """Of users by their number, as one vector; per degree of freedom."""
    assert registration.joint_covariance is not None
    users, out = list(errors), {}
    for what, which in (("x y yaw", [0, 1, 3]), ("x y z yaw", [0, 1, 2, 3])):
        e = np.concatenate([errors[u][which] for u in users])
        covariance = registration.joint_covariance[np.ix_(users, which, users, which)].reshape(len(e), len(e))
        out[what] = float(e @ np.linalg.solve(covariance, e)) / len(e)
    return out


def real_rows(folder: Path) -> list[dict[str, Any]]:
    """A row for each user of a real recording that has truth and a placement, but for the reference."""
    recording, truth = Recording.load(folder), read_tracks(folder / "truth")
    registration = register(recording)
    tracks, reference = registration.tracks(recording), registration.reference
    laid = match(tracks[reference], truth[reference]) if reference in truth else None
    if laid is None:
        return []
    frame = align([laid]).inverse()
    rows = []
    for name in sorted(truth.keys() & tracks.keys() - {reference}):
        user = registration.users[name]
        if user.static:
            where = [0, 1, 2]
            e = np.append(tracks[name].position[0] - frame @ truth[name].position[0], np.nan)
        else:
            where = [0, 1, 2, 3]
            found = _error(user, recording.tracks[name], tracks[name], truth[name], frame)
            if found is None:
                continue
            e = found
        row: dict[str, Any] = {"recording": folder.name, "user": name, "state": str(user.state)}
        row |= dict(zip(("x", "y", "z", "yaw"), e.tolist(), strict=True))
        plane = [k for k in where if k != 2]
        row["plane"], row["space"] = _square(user, e, plane), _square(user, e, where)
        row["plane in 95 %"] = row["plane"] < CHI_SQUARE_95[len(plane)]
        row["space in 95 %"] = row["space"] < CHI_SQUARE_95[len(where)]
        rows.append(row)
    return rows


def _error(user: UserRegistration, own: Track, estimated: Track, truth: Track, frame: YawFrame) -> Array | None:
    """(4,) x, y, z, yaw of the error of `common_from_user`; None where the truth does not tell.

    `estimated` is the track in the common frame, `frame` takes the truth there.
    """
    matched = match(estimated, truth)
    known = truth.at(estimated.t, 0.5).valid
    if matched is None or user.common_from_user is None or not known[-1]:
        return None
    last = estimated.t[known] > estimated.t[-1] - LAST_S
    end = Matched(matched.estimated[last], frame @ matched.true[last])
    scale = _true_scale(own, truth)
    if not end.moved or scale is None:
        return None
    ours = user.common_from_user
    turned = -align([end]).yaw
    p_true, p_own = end.true[-1], own.position[-1]
    true = YawFrame(yaw=wrap_angle(ours.yaw - turned), scale=scale)
    x, y, z = (p_true - true @ p_own).tolist()
    return _difference(ours, YawFrame(x, y, z, true.yaw, scale))


def _true_scale(own: Track, truth: Track) -> float | None:
    """The median ratio of the lengths of true steps to SLAM's."""
    t = np.arange(own.t[0], own.t[-1], STEP_S)
    ours, true = own.at(t, 1.0), truth.at(t, 0.5)
    lengths, true_lengths = (np.linalg.norm(np.diff(p.position, axis=0), axis=1) for p in (ours, true))
    known = ours.valid & true.valid
    far = known[1:] & known[:-1] & (true_lengths > LEAST_STEP_M) & (lengths > 0.0)
    return float(np.median(true_lengths[far] / lengths[far])) if far.any() else None


def _difference(ours: YawFrame, true: YawFrame) -> Array:
    return np.append(ours.translation - true.translation, wrap_angle(ours.yaw - true.yaw))


def _square(user: UserRegistration, error: Array, which: list[int]) -> float:
    if user.covariance is None:
        return np.nan
    e = error[which]
    return float(e @ np.linalg.solve(user.covariance[np.ix_(which, which)], e))


def band(degrees: int, n: int) -> tuple[float, float]:
    """Where 95 % of the averages of n chi squares of so many degrees lie, by the cube root's normal distribution."""
    total = degrees * n
    low, high = (total * (1.0 - 2.0 / (9.0 * total) + z * np.sqrt(2.0 / (9.0 * total))) ** 3 for z in (-1.96, 1.96))
    return float(low / n), float(high / n)


def main() -> None:
    """The tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--users", type=int, nargs="+", default=[2, 3, 4, 6])
    parser.add_argument("--seconds", type=float, nargs="+", default=[30.0, 60.0])
    parser.add_argument("--recordings", type=Path)
    options = parser.parse_args()
    settings = {**vars(options), "recordings": str(options.recordings)}
    rows = []
    for seconds in options.seconds:
        for users in options.users:
            tasks = [Task(users, seconds, seed) for seed in range(options.seeds)]
            found = [s for walk in on_all_cores(squares_of, tasks) for s in walk]
            rows += [_row(users, seconds, name, [s for s in found if s.user == name]) for name in _names(found)]
            rows.append(_row(users, seconds, "all", [s for s in found if s.user != JOINT]))
            rows.append(_joint_row(users, seconds, [s for s in found if s.user == JOINT]))
    print(write_table("consistency", rows, settings))
    if options.recordings is not None:
        folders = sorted(f.parent for f in options.recordings.glob("*/ranges.csv"))
        real = [row for of_folder in on_all_cores(real_rows, folders) for row in of_folder]
        print()
        print(write_table("consistency_recordings", real, settings))
        for where in ("plane", "space"):
            print(
                f"inside 95 % in the {where}: {np.mean([row[f'{where} in 95 %'] for row in real]):.0%} of {len(real)}"
            )


def _names(found: list[Squares]) -> list[str]:
    return sorted({s.user for s in found} - {JOINT})


def _row(users: int, seconds: float, name: str, found: list[Squares]) -> dict[str, Any]:
    row: dict[str, Any] = {"seconds": seconds, "users": users, "user": name, "n": len(found)}
    mine = [s for s in found if s.registered]
    row["registered"] = len(mine)
    walks = len({s.task.seed for s in mine})
    for what, degrees in DEGREES.items():
        squares = np.array([s.squares[what] for s in mine])
        low, high = band(degrees, max(walks, 1))
        mean = float(squares.mean()) if len(squares) else np.nan
        row[what] = mean
        row[f"{what} band"] = f"{low:.2f}..{high:.2f}{'' if low <= mean <= high else ' !'}"
        row[f"{what} in 95 %"] = float((squares < CHI_SQUARE_95[degrees]).mean()) if len(squares) else np.nan
    return row


def _joint_row(users: int, seconds: float, found: list[Squares]) -> dict[str, Any]:
    """Every walk weighs as many as it has users."""
    row: dict[str, Any] = {"seconds": seconds, "users": users, "user": JOINT, "n": len(found), "registered": len(found)}
    row |= {f"{what}{of_it}": "" for what in DEGREES for of_it in ("", " band", " in 95 %")}
    weight = np.array([s.users for s in found])
    for what in ("x y yaw", "x y z yaw"):
        degrees = DEGREES[what] * max(int(weight.sum()), 1)
        low, high = (edge / degrees for edge in band(degrees, 1))
        mean = float(np.average([s.squares[what] for s in found], weights=weight)) if found else np.nan
        row[what], row[f"{what} band"] = mean, f"{low:.2f}..{high:.2f}{'' if low <= mean <= high else ' !'}"
    return row


if __name__ == "__main__":
    main()
