"""Output of `check`: summary and findings of a recording, as a table and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from synchronizar.data.findings import Finding, finding_json
from synchronizar.diagnosis.summary import Summary

DEVICE_HEAD = ("user", "poses", "Hz", "extent (m)", "ranges", "place known")
PAIR_HEAD = ("pair", "ranges", "usable", "Hz", "median (m)")


def check_json(summary: Summary, findings: Sequence[Finding], refused: str | None) -> dict[str, Any]:
    """The object that `check --json` prints; s, m, Hz. `refused`: why `register` refuses the recording, or None."""
    users = {}
    for device in summary.devices:
        users[device.name] = {key: value for key, value in asdict(device).items() if key != "name"}
    ranges = {key: value for key, value in asdict(summary).items() if key not in ("devices", "pairs", "ranges")}
    return {
        "findings": [finding_json(finding) for finding in findings],
        "users": users,
        "ranges": {"count": summary.ranges, **ranges, "pairs": [asdict(pair) for pair in summary.pairs]},
        "refused": refused,
    }


def check_table(summary: Summary, findings: Sequence[Finding], refused: bool) -> str:
    """A row for each device and each pair, then a line for each finding; `refused`: whether `register` refuses it."""
    devices = [
        (
            device.name,
            "static" if device.static else str(device.poses),
            _cell(device.rate, ".1f"),
            _cell(device.extent, ".2f"),
            str(device.ranges),
            _cell(device.coverage, ".0%"),
        )
        for device in summary.devices
    ]
    pairs = [
        (f"{p.a} - {p.b}", str(p.ranges), str(p.usable), _cell(p.rate, ".1f"), _cell(p.median, ".2f"))
        for p in summary.pairs
    ]
    lines = [*_table(DEVICE_HEAD, devices), "", *(_table(PAIR_HEAD, pairs) if pairs else ["no ranges"])]
    if summary.no_distance:
        span = (
            "" if summary.shortest is None else f" (they go from {summary.shortest:.6g} m to {summary.longest:.6g} m)"
        )
        lines.append(f"{summary.no_distance} of {summary.ranges} ranges are no possible distances and not used{span}")
    lines_of_findings = findings_lines(findings) if findings or not refused else []
    return "\n".join([*lines, "", *lines_of_findings, *(["register refuses it as it is:"] if refused else [])])


def findings_lines(findings: Sequence[Finding]) -> list[str]:
    """A line for each finding; one line where there is none."""
    return [str(finding) for finding in findings] or ["nothing looks wrong"]


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Lines of a table: names flush left, numbers flush right."""
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    return [
        "  ".join(
            cell.ljust(w) if k == 0 else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in [head, *rows]
    ]


def _cell(number: float | None, form: str) -> str:
    return "-" if number is None else format(number, form)
