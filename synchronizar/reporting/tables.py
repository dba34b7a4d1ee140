"""A registration as a table of text."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees
from typing import Any

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import Registration, UserRegistration
from synchronizar.io.registration_folder import range_counts
from synchronizar.reporting.evaluate import Evaluation

_REFERENCE = "the reference: its own frame at its last pose, in that at its first"


def registration_table(registration: Registration) -> str:
    """A row for each user: frame (m, degrees), 1 sigma, state and reason; below them the counts of ranges."""
    head = ("user", "state", "x (m)", "y (m)", "z (m)", "yaw (°)", "± xy (m)", "± z (m)", "± yaw (°)", "")
    rows = [head, *(_table_row(registration, user) for user in registration.users.values())]
    widths = [max(len(row[k]) for row in rows) for k in range(len(head))]
    lines = ["  ".join([*_aligned(row[:-1], widths), row[-1]]).rstrip() for row in rows]
    counts = ", ".join(f"{count} {what}" for what, count in range_counts(registration.ranges).items())
    lines.append(f"ranges: {counts}; {sum(registration.seconds.values()):.2f} s")
    findings = ["", *map(str, registration.findings)] if registration.findings else []
    return "\n".join([*lines, *findings])


def answer_table(answer: Mapping[str, Any]) -> str:
    """A row for each user of a room's answer, a registration.json object: frame (m, degrees), state and reason."""
    rows = [("user", "state", "x (m)", "y (m)", "z (m)", "yaw (°)", "")]
    for name, user in answer.get("users", {}).items():
        place = (*(user[key] for key in ("x", "y", "z")), None if user["yaw"] is None else degrees(user["yaw"]))
        cells = [_optional_cell(x, form) for x, form in zip(place, ("+.2f", "+.2f", "+.2f", "+.1f"), strict=True)]
        why = _REFERENCE if name == answer.get("reference") else user["reason"]
        rows.append((name, user["state"], cells[0], cells[1], cells[2], cells[3], why))
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return "\n".join("  ".join([*_aligned(row[:-1], widths), row[-1]]).rstrip() for row in rows)


def _table_row(registration: Registration, user: UserRegistration) -> tuple[str, ...]:
    frame = user.common_from_user
    position_yaw = (np.nan,) * 4
    if frame is not None:
        position_yaw = (frame.x, frame.y, frame.z, np.nan if user.static else np.degrees(frame.yaw))
    sigma_xy, sigma_z, sigma_yaw = _sigmas(user.covariance)
    return (
        user.name,
        str(user.state),
        *(_cell(x, "+.2f") for x in position_yaw[:3]),
        _cell(position_yaw[3], "+.1f"),
        _cell(sigma_xy, ".2f"),
        _cell(sigma_z, ".2f"),
        _cell(np.degrees(sigma_yaw), ".1f"),
        _REFERENCE if user.name == registration.reference else user.reason,
    )


def _sigmas(covariance: Array | None) -> tuple[float, float, float]:
    """1 sigma along the longer axis of the ellipse in x and y (m), in z (m) and in yaw (rad); NaN where unknown."""
    if covariance is None:
        return np.nan, np.nan, np.nan
    xx, yy, xy = covariance[0, 0], covariance[1, 1], covariance[0, 1]
    longest = (xx + yy) / 2.0 + np.hypot((xx - yy) / 2.0, xy)
    return float(np.sqrt(longest)), float(np.sqrt(covariance[2, 2])), float(np.sqrt(covariance[3, 3]))


def _cell(x: float, form: str) -> str:
    return format(x, form) if np.isfinite(x) else "-"


def _aligned(cells: tuple[str, ...], widths: list[int]) -> list[str]:
    """Cells padded to widths: names and states flush left, numbers flush right."""
    return [c.ljust(w) if k < 2 else c.rjust(w) for k, (c, w) in enumerate(zip(cells, widths, strict=False))]


def evaluation_table(e: Evaluation) -> str:
    """Errors in m and degrees, a row for each alignment to the truth."""
    whose = "the survey's frame" if e.reference is None else f"{e.reference}'s"
    rows = [
        ("all together", e.joint_ate, e.joint_ate_xy, None),
        *([] if e.reference is None else [(f"{e.reference} alone", e.reference_ate, e.reference_ate_xy, None)]),
        *((f"{name} in {whose}", e.transfer[name], e.transfer_xy[name], e.yaw[name]) for name in e.transfer),
    ]
    width = max(len(row[0]) for row in rows)
    lines = [f"{'aligned':{width}}  RMSE (m)  in x, y (m)  yaw (°)"]
    for what, rmse, rmse_xy, yaw in rows:
        turn = None if yaw is None else degrees(yaw)
        cells = _optional_cell(rmse, ".3f"), _optional_cell(rmse_xy, ".3f"), _optional_cell(turn, "+.2f")
        lines.append(f"{what:{width}}  {cells[0]:>8}  {cells[1]:>11}  {cells[2]:>7}")
    if e.missing:
        lines.append(f"no estimate of {', '.join(e.missing)}")
    return "\n".join(lines)


def _optional_cell(number: float | None, form: str) -> str:
    return "-" if number is None else format(number, form)
