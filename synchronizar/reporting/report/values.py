"""What the report shows of an answer, as one JSON object.

Times are whole milliseconds since the first range, by the range clock; positions whole millimetres in the common frame:
a file is a third as long as with decimals. Other numbers are in m, rad and s. Long recordings are thinned evenly, and
the object says to what share; figures are always those of all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Array
from synchronizar.data.findings import finding_json
from synchronizar.data.jump import Jump
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.io.json_values import number_json
from synchronizar.io.registration_folder import range_counts
from synchronizar.reporting.answer import Answer
from synchronizar.reporting.drift import drift_of
from synchronizar.reporting.history import History, UserHistory
from synchronizar.reporting.uncertainty import axes_of, plane_covariance

MOST_POSES = 60_000
"""Poses of all tracks together, at most."""
MOST_RANGES = 60_000
MOST_UPDATES = 2_000
MOST_OF_ANOTHER_WALK = 400
"""Poses of a walk that the ranges allow as well, at most."""
USED, REJECTED, UNUSABLE = range(3)
STATES = tuple(State)


def report_values(answer: Answer, history: History | None, title: str) -> dict[str, Any]:
    """The object. `history`: the states over time that a replay wrote; None for a registration of the whole walk."""
    registration, verdicts = answer.registration, answer.registration.ranges
    every_pose = _every(sum(len(track) for track in answer.tracks.values()), MOST_POSES)
    every_range = _every(len(answer.ranges), MOST_RANGES)
    return {
        "title": title,
        "causal": history is not None,
        "reference": answer.reference,
        "model": registration.model,
        "method": registration.method,
        "counts": range_counts(verdicts),
        "began": answer.began,
        "sigma": answer.range_sigma,
        "every_pose": every_pose,
        "every_range": every_range,
        "states": [str(state) for state in STATES],
        "users": [_user(answer, history, name, every_pose) for name in answer.names],
        "ranges": _ranges(answer, every_range),
        "pairs": _pairs(answer),
        "updates": None if history is None else _thousandths(history.t[:: _every(len(history.t), MOST_UPDATES)]),
        "events": [] if history is None else [[round(1e3 * t), text] for t, text in history.events],
        "alternatives": [number_json(other.cost) for other in registration.alternatives],
        "findings": [finding_json(finding) for finding in registration.findings],
    }


def _user(answer: Answer, history: History | None, name: str, every: int) -> dict[str, Any]:
    user, track = answer.registration.users[name], answer.tracks.get(name)
    frame, sigma = user.common_from_user, user.calibration_sigma
    out: dict[str, Any] = {
        "name": name,
        "static": user.static,
        "state": STATES.index(user.state),
        "reason": user.reason,
        "scale": None if frame is None else frame.scale,
        "range_bias": user.range_bias,
        "clock_offset": user.clock_offset,
        "sigma": None if sigma is None else {of: number_json(x) for of, x in sigma._asdict().items()},
        "slam_noise": user.slam_noise,
        "prior_dominated": user.prior_dominated,
        "track": None,
        "ellipse": None,
        "height_sigma": None,
        "yaw_sigma": None,
        "drift": None,
        "others": [],
        "jumps": [_jump(answer, name, jump) for jump in user.jumps],
        "history": None if history is None else _history(history, history.users[name]),
    }
    if track is not None:
        out["track"] = _track(answer, name, track, every)
        if history is None and answer.corrects_slam and not user.static:
            out["drift"] = float(drift_of(answer, name).distance[-1])
        if user.state is State.AMBIGUOUS:
            out["others"] = [
                _thousandths(walk[:: _every(len(walk), MOST_OF_ANOTHER_WALK), :2]) for walk in answer.other_walks(name)
            ]
        if user.covariance is not None:
            (longer, shorter), angle = axes_of(plane_covariance(user, track.position[-1]))
            out["ellipse"] = [float(longer), float(shorter), angle]
            out["height_sigma"], out["yaw_sigma"] = (
                number_json(np.sqrt(max(user.covariance[k, k], 0.0))) for k in (2, 3)
            )
    return out


def _track(answer: Answer, name: str, track: Track, every: int) -> dict[str, list[int]]:
    """Columns of its poses, the last among them; a static radio's single pose has t = 0."""
    last = len(track) - 1
    rows = np.unique(np.append(np.arange(0, last + 1, every), last))
    t = track.t[rows] if answer.registration.users[name].static else answer.elapsed(name, track.t[rows])
    x, y, z = track.position[rows].T
    return {column: _thousandths(values) for column, values in {"t": t, "x": x, "y": y, "z": z}.items()}


def _jump(answer: Answer, name: str, jump: Jump) -> dict[str, Any]:
    """One jump, and where the device was then: null where that is not known."""
    t, place = answer.elapsed(name, np.array([jump.t])), None
    track = answer.tracks.get(name)
    if track is not None:
        at = track.at(np.array([jump.t]), 1.0)
        place = _thousandths(at.position[0]) if at.valid[0] else None
    return {"t": round(1e3 * float(t[0])), "place": place} | {
        of: getattr(jump, of) for of in ("distance", "turn", "tilt")
    }


def _history(history: History, user: UserHistory) -> dict[str, Any]:
    """State by the times at which it changed; progress and sigma at the updates that are shown."""
    changes = [n for n, state in enumerate(user.states) if n == 0 or state is not user.states[n - 1]]
    cues = [n for n, cue in enumerate(user.cues) if n == 0 or cue != user.cues[n - 1]]
    shown = slice(None, None, _every(len(history.t), MOST_UPDATES))
    return {
        "states": [[round(1e3 * history.t[n]), STATES.index(user.states[n])] for n in changes],
        "cues": [[round(1e3 * history.t[n]), user.cues[n]] for n in cues],
        "progress": _thousandths(user.progress[shown]),
        "sigma": _thousandths(user.sigma_xy[shown]),
        "yaw_sigma": _thousandths(user.sigma_yaw[shown]),
    }


def _ranges(answer: Answer, every: int) -> dict[str, list[Any]]:
    """Columns of the ranges that are shown, in the order of time."""
    ranges, verdicts = answer.ranges, answer.registration.ranges
    rows = np.argsort(ranges.t, kind="stable")[::every]
    verdict = np.select([verdicts.used, verdicts.usable], [USED, REJECTED], default=UNUSABLE)
    return {
        "t": _thousandths(ranges.t[rows] - answer.began),
        "a": ranges.a[rows].tolist(),
        "b": ranges.b[rows].tolist(),
        "distance": _thousandths(ranges.distance[rows]),
        "residual": _thousandths(verdicts.residual[rows]),
        "verdict": verdict[rows].tolist(),
    }


def _pairs(answer: Answer) -> list[dict[str, Any]]:
    """Each pair that ranged, and figures of all of its ranges; a residual is measured minus predicted."""
    ranges, count = answer.ranges, len(answer.names)
    low, high = np.minimum(ranges.a, ranges.b).astype(np.int64), np.maximum(ranges.a, ranges.b).astype(np.int64)
    keys, of_pair = np.unique(low * count + high, return_inverse=True)
    order = np.argsort(of_pair, kind="stable")
    rows_of = np.split(order, np.cumsum(np.bincount(of_pair, minlength=len(keys)))[:-1]) if len(keys) else []
    return [
        {"a": key // count, "b": key % count, **_pair_figures(answer, rows)}
        for key, rows in zip(keys.tolist(), rows_of, strict=True)
    ]


def _pair_figures(answer: Answer, rows: NDArray[np.intp]) -> dict[str, Any]:
    verdicts = answer.registration.ranges
    used, usable = verdicts.used[rows], verdicts.usable[rows]
    residual, distance = verdicts.residual[rows[used]], answer.ranges.distance[rows[usable]]
    return {
        "used": int(used.sum()),
        "rejected": int((usable & ~used).sum()),
        "unusable": int((~usable).sum()),
        "rms": _figure(np.sqrt(np.mean(residual**2)) if len(residual) else np.nan),
        "mean": _figure(residual.mean() if len(residual) else np.nan),
        "worst": _figure(residual[np.argmax(np.abs(residual))] if len(residual) else np.nan),
        "distance": _figure(np.median(distance) if len(distance) else np.nan),
    }


def _figure(x: float) -> float | None:
    """To a tenth of a millimetre."""
    return number_json(round(float(x), 4))


def _every(count: int, most: int) -> int:
    """Of so many the first of each so many, so that `most` at most are left."""
    return max(1, -(-count // most))


def _thousandths(values: Array) -> list[Any]:
    """(...) in whole thousandths; None where a number is not finite."""
    thousandths = np.round(1e3 * values)
    if np.isfinite(thousandths).all():
        return list(thousandths.astype(np.int64).tolist())
    return _nested(thousandths.tolist())


def _nested(values: Sequence[Any]) -> list[Any]:
    return [
        _nested(value) if isinstance(value, list) else int(value) if np.isfinite(value) else None for value in values
    ]
