"""Reads PyFG factor graphs, as CORA and PyFactorGraph have them: robots' odometry, ranges, and true poses.

    VERTEX_SE2 t A0 x y theta               VERTEX_SE3:QUAT t A0 x y z qx qy qz qw
    VERTEX_XY L0 x y                        VERTEX_XYZ L0 x y z
    EDGE_SE2 t A0 A1 x y theta cov(6)       EDGE_SE3:QUAT t A0 A1 x y z qx qy qz qw cov(21)
    EDGE_RANGE t A0 L0 range variance
    VERTEX_XY:PRIOR t L0 x y cov(3)         VERTEX_XYZ:PRIOR t L0 x y z cov(6)

| | |
|---|---|
| time | s; a pose has its vertex's stamp, a range those of the poses it ties (their mean), so that all clocks are one |
| units | m, rad; the last number of a range is its variance, taken as sigma with `--sigma` |
| frames | z up. A track is what a robot's odometry edges add up to, from the origin with the tilt of its first vertex |
| users | the letters of a pose's name, one each: A of A0, A1, ...; a landmark is a static radio, by its whole name |
| truth | the vertices (the format's true values) become `truth/` |
| assumed | a robot without odometry has its vertices for a track; poses without stamps of their own are 1 s apart |
| surveyed | landmarks with a prior: `position`, and `position_sigma` by the mean of its variances |
| not read | priors of poses, loop closures, edges between robots, bearings to landmarks: they are counted and said |
| refused | an edge of a vertex that is not there, lines with too few numbers or with what is no number |
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.asked import Asked
from synchronizar.convert.imported import Imported
from synchronizar.convert.source import Source
from synchronizar.convert.surveyed import add_surveyed
from synchronizar.convert.tables import lines_of
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.io.text import is_plain, quoted
from synchronizar.progress import Progress
from synchronizar.quaternions import (
    IDENTITY,
    inverse_quaternions,
    multiply_quaternions,
    rotate_by_quaternions,
    yaw_of_quaternions,
    yaw_quaternion,
)

_POSES = {"VERTEX_SE2": 3, "VERTEX_SE3:QUAT": 7}
"""Numbers of a pose after its stamp and name."""
_POINTS = {"VERTEX_XY": 2, "VERTEX_XYZ": 3}
_ODOMETRY = {"EDGE_SE2": 3, "EDGE_SE3:QUAT": 7}
_KINDS = re.compile(r"(VERTEX|EDGE)_[A-Z0-9]+(:[A-Z]+)*")
_POSE_NAME = re.compile(r"(.*?[^\d_])_?(\d+)")


@dataclass
class _Robot:
    """Poses of one robot in the order of the file, and its odometry."""

    names: list[str] = field(default_factory=list)
    t: list[float] = field(default_factory=list)
    poses: list[list[float]] = field(default_factory=list)
    """x y z qx qy qz qw."""
    steps: dict[tuple[str, str], list[float]] = field(default_factory=dict)


@dataclass
class _Graph:
    robots: dict[str, _Robot] = field(default_factory=dict)
    robot_of: dict[str, str] = field(default_factory=dict)
    """Whose each pose is."""
    landmarks: dict[str, list[float]] = field(default_factory=dict)
    priors: dict[str, tuple[int, list[float], float]] = field(default_factory=dict)
    """Of landmarks: line, place, and the mean of its variances."""
    steps: list[tuple[int, str, str, list[float]]] = field(default_factory=list)
    """Line, the two poses, and the second in the first."""
    ranges: list[tuple[int, float, str, str, float, float]] = field(default_factory=list)
    """Line, t, the two vertices, range and variance."""
    not_read: Counter[str] = field(default_factory=Counter)


def recognises(source: Source) -> bool:
    """Lines that begin with VERTEX_ or EDGE_ and name a vertex, as PyFG does (g2o has numbers)."""
    words = [line.split() for line in source.lines if not line.startswith("#")]
    return bool(words) and all(_KINDS.fullmatch(w[0]) and _names_a_vertex(w) for w in words)


def _names_a_vertex(words: list[str]) -> bool:
    return any(word[:1].isalpha() for word in words[1:3])


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """Tracks, truth and ranges. Raises InputError that names the line."""
    graph = _graph(path, progress)
    imported = Imported()
    stamps: dict[str, float] = {}
    for name, robot in sorted(graph.robots.items()):
        _add_robot(imported, name, robot, stamps)
    for name, point in graph.landmarks.items():
        imported.users[name] = User(name, static=True)
        imported.truth[name] = np.array([[0.0, *point, *IDENTITY]])
    for name, (line, _, _) in graph.priors.items():
        if name not in graph.landmarks:
            raise InputError(path, f"a prior of {quoted(name)}, which is no landmark of this file", line)
    sigmas = {name: float(np.sqrt(max(variance, 0.0))) for name, (_, _, variance) in graph.priors.items()}
    add_surveyed(imported, {name: place for name, (_, place, _) in graph.priors.items()}, sigmas)
    for line, t, a, b, distance, variance in graph.ranges:
        ends = []
        for vertex in (a, b):
            if vertex not in graph.robot_of and vertex not in graph.landmarks:
                raise InputError(path, f"a range of {quoted(vertex)}, which is no vertex of this file", line)
            ends.append(graph.robot_of.get(vertex, vertex))
        if ends[0] == ends[1]:
            graph.not_read["ranges of a robot to itself"] += 1
            continue
        known = [stamps[vertex] for vertex in (a, b) if vertex in stamps]
        sigma = float(np.sqrt(variance)) if asked.sigma and variance > 0.0 else np.nan
        imported.ranges.add(sum(known) / len(known) if known else t, ends[0], ends[1], distance, sigma=sigma)
    if not asked.sigma and graph.ranges:
        imported.note("variances of ranges are not taken, since they tell of noise alone (--sigma takes them)")
    for what, count in sorted(graph.not_read.items()):
        imported.note(f"{count} {what} are not read")
    return imported


def _graph(path: Path, progress: Progress) -> _Graph:
    graph = _Graph()
    for number, line in lines_of(path, progress):
        if words := line.partition("#")[0].split():
            _take(path, number, words, graph)
    if not graph.robots and not graph.landmarks:
        raise InputError(path, "has no vertex: no VERTEX_SE2, VERTEX_SE3:QUAT, VERTEX_XY or VERTEX_XYZ")
    for number, a, b, step in graph.steps:
        for vertex in (a, b):
            if vertex not in graph.robot_of:
                raise InputError(path, f"an edge of {quoted(vertex)}, which is no pose of this file", number)
        if graph.robot_of[a] == graph.robot_of[b]:
            graph.robots[graph.robot_of[a]].steps[a, b] = step
        else:
            graph.not_read["edges between robots"] += 1
    return graph


def _take(path: Path, line: int, words: list[str], graph: _Graph) -> None:
    kind = words[0]
    if kind in _POSES:
        name, numbers = _at(path, line, words, 2), _numbers(path, line, words, 3, _POSES[kind])
        t = _numbers(path, line, words, 1, 1)[0]
        parts = _POSE_NAME.fullmatch(name)
        robot = parts[1] if parts else name
        if name in graph.robot_of:
            raise InputError(path, f"{quoted(name)} is a vertex twice: give each pose a name of its own", line)
        graph.robot_of[name] = robot
        of = graph.robots.setdefault(robot, _Robot())
        of.names.append(name)
        of.t.append(t)
        of.poses.append(_pose(path, line, numbers))
    elif kind in _POINTS:
        place = 2 if words[1:2] and _is_number(words[1]) else 1
        numbers = _numbers(path, line, words, place + 1, _POINTS[kind])
        graph.landmarks[_at(path, line, words, place)] = [*numbers, 0.0][:3]
    elif kind.removesuffix(":PRIOR") in _POINTS:
        size = _POINTS[kind.removesuffix(":PRIOR")]
        numbers = _numbers(path, line, words, 3, size + size * (size + 1) // 2)
        # Covariances stand column by column, each from the diagonal on.
        variances = [numbers[size + k * size - k * (k - 1) // 2] for k in range(size)]
        graph.priors[_at(path, line, words, 2)] = (line, [*numbers[:size], 0.0][:3], sum(variances) / size)
    elif kind in _ODOMETRY:
        step = _pose(path, line, _numbers(path, line, words, 4, _ODOMETRY[kind]))
        graph.steps.append((line, _at(path, line, words, 2), _at(path, line, words, 3), step))
    elif kind.startswith("EDGE_RANGE"):
        t = _numbers(path, line, words, 1, 1)[0]
        distance = _numbers(path, line, words, 4, 1)[0]
        variance = _numbers(path, line, words, 5, 1)[0] if len(words) > 5 else np.nan
        graph.ranges.append((line, t, _at(path, line, words, 2), _at(path, line, words, 3), distance, variance))
    elif _KINDS.fullmatch(kind):
        graph.not_read[f"{kind} lines"] += 1
    else:
        raise InputError(path, f"{quoted(kind)} begins no line of a PyFG file: there are VERTEX_... and EDGE_...", line)


def _at(path: Path, line: int, words: list[str], place: int) -> str:
    if place >= len(words):
        raise InputError(path, f"{words[0]} lacks the name of a vertex", line)
    return words[place]


def _numbers(path: Path, line: int, words: list[str], first: int, count: int) -> list[float]:
    values = words[first : first + count]
    if len(values) < count:
        raise InputError(path, f"{words[0]} needs {first - 1 + count} values, here are {len(words) - 1}", line)
    for value in values:
        if not _is_number(value):
            raise InputError(path, f"{quoted(value)} is no number", line)
    return [float(value) for value in values]


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text))) and is_plain(text)
    except ValueError:
        return False


def _pose(path: Path, line: int, numbers: list[float]) -> list[float]:
    """A pose in the plane or in space as x y z qx qy qz qw."""
    if len(numbers) == 3:
        x, y, theta = numbers
        return [x, y, 0.0, *yaw_quaternion(theta).tolist()]
    length = float(np.linalg.norm(numbers[3:]))
    if not length > 0.0:
        raise InputError(path, "the quaternion is zero", line)
    return [*numbers[:3], *(q / length for q in numbers[3:])]


def _add_robot(imported: Imported, name: str, robot: _Robot, stamps: dict[str, float]) -> None:
    t = np.array(robot.t)
    order = np.argsort(t, kind="stable")
    if len(np.unique(t)) < 0.5 * len(t):
        imported.note(f"most of {name}'s poses have the stamp of another: they are taken to be 1 s apart")
        t, order = np.arange(float(len(t))), np.arange(len(t))
    poses = np.array(robot.poses)[order]
    names = [robot.names[k] for k in order.tolist()]
    rows = np.column_stack([t[order], poses])
    stamps.update(zip(names, rows[:, 0].tolist(), strict=True))
    imported.truth[name] = rows
    following = [robot.steps.get(pair) for pair in pairwise(names)]
    odometry = sum(step is not None for step in following)
    if other := len(robot.steps) - odometry:
        imported.note(f"{other} edges of {name} between poses that do not follow each other are not read")
    if len(names) > 1 and not odometry:
        imported.note(f"{name} has no odometry: its vertices are its track")
        imported.tracks[name] = rows
        return
    first, last = _longest_run([step is not None for step in following])
    if last - first < len(names):
        imported.note(
            f"{name}'s odometry is broken: the longest unbroken part is its track, {last - first} of {len(names)} poses"
        )
    steps = np.array(following[first : last - 1], dtype=float).reshape(-1, 7)
    imported.tracks[name] = np.column_stack([rows[first:last, 0], _added_up(poses[first, 3:], steps)])


def _longest_run(there: list[bool]) -> tuple[int, int]:
    """First pose of the longest unbroken run, and the one after its last; `there`: whether each step is."""
    best, begin = (0, 1), 0
    for k, known in enumerate([*there, False]):
        if not known:
            if k + 1 - begin > best[1] - best[0]:
                best = begin, k + 1
            begin = k + 1
    return best


def _added_up(first_quat: Array, steps: Array) -> Array:
    """(n + 1, 7) poses that n steps lead to, from the origin with the tilt of an attitude and no yaw."""
    back = inverse_quaternions(yaw_quaternion(float(yaw_of_quaternions(first_quat))))
    quat = np.empty((len(steps) + 1, 4))
    quat[0] = multiply_quaternions(back, first_quat)
    for k, turn in enumerate(steps[:, 3:]):
        q = multiply_quaternions(quat[k], turn)
        quat[k + 1] = q / np.linalg.norm(q)
    moves = rotate_by_quaternions(quat[:-1], steps[:, :3])
    return np.column_stack([np.vstack([np.zeros(3), np.cumsum(moves, axis=0)]), quat])
