"""What surrounds everybody, what was pointed at, and who sees through whose eyes. All of it stands as objects."""

from __future__ import annotations

from math import isfinite
from typing import Any, TypeGuard

from synchronizar.apps.eyes.scan import FLOOR, MARK, SCAN, Cube, cells_of, cubes_of
from synchronizar.apps.looks import LOOK, Looks
from synchronizar.live import messages as m
from synchronizar.live.applications import Application
from synchronizar.live.stage import Stage

MOST_CUBES = 1500
MOST_MARKS = 100
FARTHEST_M = 200.0


class Eyes(Application):
    """Words: those of `Looks`; `seen`, `floor` {z}, `forget`; `mark` {position}, `unmark` {id}.

    `seen` has cubes of cells, see `scan.py`. The floor lies as high as whoever saw it first has it: heights are known
    badly from distances, so that all others put what they see on that one floor.
    """

    title = "Look through my eyes"
    summary = "See what somebody else sees, walk through the room's model, point at things for everybody."
    kinds = (LOOK, SCAN, MARK, FLOOR)

    def __init__(self) -> None:
        self._looks = Looks()

    def said(self, stage: Stage, by: str, topic: str, data: Any) -> None:
        """A word of somebody; `by` is empty for the room's page, which adds stored scans."""
        given = data if isinstance(data, dict) else {}
        self._looks.said(stage, by, topic, data)
        match topic:
            case "seen" if not by or by in stage.players:
                for cube in cubes_of(data):
                    self._add(stage, cube)
            case "floor" if by in stage.players and FLOOR not in stage.objects:
                if _finite(z := given.get("z")):
                    stage.create(FLOOR, FLOOR, (0.0, 0.0, float(z)))
            case "forget":
                for o in [*_of(stage, SCAN), *_of(stage, FLOOR)]:
                    stage.remove(o.id)
            case "mark":
                self._mark(stage, by, given.get("position"))
            case "unmark":
                if any(o.id == given.get("id") for o in _of(stage, MARK)):
                    stage.remove(given["id"])

    def tick(self, stage: Stage) -> None:
        """Who has left is seen no more."""
        self._looks.tick(stage)

    def _add(self, stage: Stage, cube: Cube) -> None:
        known = stage.objects.get(cube.id)
        if known is None:
            if len(_of(stage, SCAN)) < MOST_CUBES:
                stage.create(cube.id, SCAN, cube.corner, data=cube.text)
            return
        before = cells_of(known.data) or 0
        merged = Cube(cube.at, before | cube.cells)
        if merged.cells != before:
            stage.move(cube.id, data=merged.text)

    def _mark(self, stage: Stage, by: str, position: Any) -> None:
        if not (isinstance(position, list) and len(position) == 3 and all(map(_finite, position))):
            return
        marks = sorted(_of(stage, MARK), key=lambda o: int(o.id.rpartition(" ")[2]))
        if len(marks) >= MOST_MARKS:
            stage.remove(marks[0].id)
        number = 1 + int(marks[-1].id.rpartition(" ")[2]) if marks else 0
        x, y, z = map(float, position)
        stage.create(f"mark {number}", MARK, (x, y, z), data={"by": by})


def _finite(v: Any) -> TypeGuard[float]:
    return isinstance(v, int | float) and isfinite(v) and abs(v) < FARTHEST_M


def _of(stage: Stage, kind: str) -> list[m.Object]:
    return [o for o in stage.objects.values() if o.kind == kind]
