"""What surrounds everybody, as filled cells of a grid in the common frame, in cubes of 16 cells a side.

A cube is 512 bytes, one bit a cell, x fastest, then y, then z: 700 characters of base64, which is small enough for an
object's data, and two people's are merged by or.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from binascii import Error
from typing import Any, NamedTuple

import numpy as np

from synchronizar.arrays import Array

SCAN, MARK, FLOOR = "eyes scan", "eyes mark", "eyes floor"
"""Kinds of objects; the floor's one object has that name as its id."""
CELL_M = 0.08
SIDE = 16
BYTES = SIDE**3 // 8
FARTHEST = 100
"""Cubes from the origin: 128 m."""
MOST_SEEN = 11
"""Cubes in one word, which has 8 kB at most."""
AGAIN_S = 1.0
"""s: a cell counts that was seen in two of these; what walks through is not there in both."""


class Cube(NamedTuple):
    """Which cube, and its cells."""

    at: tuple[int, int, int]
    cells: int
    """One bit each."""

    @property
    def corner(self) -> tuple[float, float, float]:
        """m, common frame: its least x, y and z."""
        x, y, z = (SIDE * CELL_M * n for n in self.at)
        return x, y, z

    @property
    def text(self) -> str:
        """Its cells in base64."""
        return b64encode(self.cells.to_bytes(BYTES, "little")).decode("ascii")

    @property
    def id(self) -> str:
        """Of the object that it is."""
        return "scan {} {} {}".format(*self.at)


def cells_of(text: Any) -> int | None:
    """The cells of base64; None where that is no cube's."""
    if not isinstance(text, str):
        return None
    try:
        read = b64decode(text, validate=True)
    except (Error, ValueError):
        return None
    return int.from_bytes(read, "little") if len(read) == BYTES else None


def cubes_of(data: Any) -> list[Cube]:
    """The cubes of a word `seen`, [[i, j, k, cells in base64], ...]; what is malformed is left out."""
    if not isinstance(data, list):
        return []
    cubes = []
    for item in data[:MOST_SEEN]:
        if not (isinstance(item, list) and len(item) == 4):
            continue
        *at, text = item
        cells = cells_of(text)
        if cells and all(type(n) is int and abs(n) <= FARTHEST for n in at):
            cubes.append(Cube((at[0], at[1], at[2]), cells))
    return cubes


class Sightings:
    """What a program's sensor sees, a robot's lidar say, until it is told: each cell once."""

    def __init__(self) -> None:
        self._seen: dict[tuple[int, int, int], float] = {}
        """Of each cell of when it was first seen (s), infinite once it was seen again."""
        self._new: list[tuple[int, int, int]] = []

    def add(self, points: Array, t: float) -> None:
        """Points (n, 3) m of surfaces, in the common frame and from the room's floor, seen at `t` (s)."""
        for x, y, z in np.unique(np.floor(points / CELL_M).astype(int), axis=0).tolist():
            cell = (x, y, z)
            if t - self._seen.setdefault(cell, t) >= AGAIN_S:
                self._seen[cell] = float("inf")
                self._new.append(cell)

    def take(self) -> list[list[list[Any]]]:
        """The data of words `seen`: what was not told yet."""
        new, self._new = self._new, []
        return seen((np.array(new) + 0.5) * CELL_M) if new else []


def seen(points: Array) -> list[list[list[Any]]]:
    """The data of words `seen` for points (n, 3) m of surfaces in the common frame."""
    cell = np.unique(np.floor(points / CELL_M).astype(int), axis=0)
    cube, within = np.floor_divide(cell, SIDE), np.mod(cell, SIDE)
    bit = within @ np.array([1, SIDE, SIDE**2])
    at, which = np.unique(cube, axis=0, return_inverse=True)
    told = []
    for n, where in enumerate(at.tolist()):
        flags = np.zeros(SIDE**3, dtype=np.uint8)
        flags[bit[which.ravel() == n]] = 1
        cells = int.from_bytes(np.packbits(flags, bitorder="little").tobytes(), "little")
        told.append([*where, Cube((where[0], where[1], where[2]), cells).text])
    return [told[n : n + MOST_SEEN] for n in range(0, len(told), MOST_SEEN)]


def middles(cube: Cube) -> Array:
    """(n, 3) m, common frame: the middles of its filled cells."""
    flags = np.unpackbits(np.frombuffer(cube.cells.to_bytes(BYTES, "little"), dtype=np.uint8), bitorder="little")
    bit = np.flatnonzero(flags)
    cell = np.column_stack([bit % SIDE, bit // SIDE % SIDE, bit // SIDE**2])
    return np.asarray((np.array(cube.at) * SIDE + cell + 0.5) * CELL_M)
