"""CPU time and memory of this process and of all that it started."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

_TICKS = os.sysconf("SC_CLK_TCK")
_PAGE = os.sysconf("SC_PAGE_SIZE")
# Of /proc/<pid>/stat behind the name: the parent's id, and clock ticks of its own and of children that have ended.
_POSES = 2000
_PARENT, _USED, _RESIDENT = 1, slice(11, 15), 21


def cpu_seconds() -> float:
    """s: of all threads of this process, of all processes that it started, and of theirs; ended or not (Linux)."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime + sum(_used(row) for row in _descendants())


def resident_mb() -> float:
    """MB that this process and all that it started hold now, what they share counted once for each."""
    own = _stat(Path("/proc/self"))
    return sum(int(row[_RESIDENT]) for row in [*([own] if own else []), *_descendants()]) * _PAGE / 2**20


class Usage(NamedTuple):
    """Of a process, or several."""

    cpu: float
    """s since they began."""
    megabytes: float


def usage_of(process: int) -> tuple[Usage, Usage]:
    """Of a running process, and of all that it started that run still."""
    rows = _below(process)
    return tuple(_usage([row for n, row in rows.items() if (n == process) is own]) for own in (True, False))  # type: ignore[return-value]


def usage_by_kind(process: int, kinds: Mapping[str, bytes]) -> dict[str, Usage]:
    """Of a running process (`own`), and of all that it started that run still, by what stands in their command lines.

    Where several kinds fit the first counts; what fits none is left out.
    """
    rows: dict[str, list[list[str]]] = {"own": [], **{kind: [] for kind in kinds}}
    for number, row in _below(process).items():
        if number == process:
            rows["own"].append(row)
            continue
        with suppress(OSError):
            command = Path(f"/proc/{number}/cmdline").read_bytes()
            if kind := next((kind for kind, part in kinds.items() if part in command), None):
                rows[kind].append(row)
    return {kind: _usage(of) for kind, of in rows.items()}


def processes_below(process: int) -> list[int]:
    """Numbers of all running processes that a process started, and of theirs."""
    return [n for n in _below(process) if n != process]


def _usage(rows: list[list[str]]) -> Usage:
    used = sum(int(ticks) for row in rows for ticks in row[_USED][:2]) / _TICKS
    return Usage(used, sum(int(row[_RESIDENT]) for row in rows) * _PAGE / 2**20)


def _used(row: list[str]) -> float:
    return sum(int(ticks) for ticks in row[_USED]) / _TICKS


def _descendants() -> list[list[str]]:
    """The rows of all running processes below this one."""
    return [row for n, row in _below(os.getpid()).items() if n != os.getpid()]


def _below(process: int) -> dict[int, list[str]]:
    """The rows of a process and of all running processes below it."""
    rows = {int(p.name): row for p in Path("/proc").iterdir() if p.name.isdigit() and (row := _stat(p))}
    below = {process}
    while found := [n for n, row in rows.items() if n not in below and int(row[_PARENT]) in below]:
        below.update(found)
    return {n: rows[n] for n in below if n in rows}


def _stat(process: Path) -> list[str] | None:
    try:
        return (process / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None


def yardstick_seconds() -> float:
    """CPU s, the least of three: gtsam eliminates a fixed chain of poses on the plane, C++ alone and small matrices.

    Figures in multiples of it can be set beside those of another machine, or of a busy one.
    """
    import gtsam

    noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for n in range(_POSES):
        values.insert(n, gtsam.Pose2(0.5 * n, 0.0, 0.1))
        for back in (1, 10, 100):
            if n >= back:
                graph.add(gtsam.BetweenFactorPose2(n - back, n, gtsam.Pose2(0.5 * back, 0.0, 0.0), noise))
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), noise))
    linear = graph.linearize(values)
    seconds = []
    for _ in range(3):
        began = time.process_time()
        linear.optimize()
        seconds.append(time.process_time() - began)
    return min(seconds)
