"""Who sees through whose eyes, what surrounds everybody, and what was pointed at. All of it stands as objects.

Nobody is seen who has not said yes, and either of the two ends it. Pictures themselves do not pass here: who is seen
sends them to whom it has allowed.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

from synchronizar.apps.eyes.scan import Cube, cells_of, cubes_of
from synchronizar.live import messages as m
from synchronizar.live.applications import Application
from synchronizar.live.stage import Stage

LOOK, SCAN, MARK = "eyes look", "eyes scan", "eyes mark"
ASKED, ON, REFUSED = "asked", "on", "refused"
WAITS_S = 60.0
"""s: a question that nobody answers is gone."""
REFUSED_S = 10.0
"""s: so long whoever was refused does not ask again."""
MOST_CUBES = 1500
MOST_MARKS = 100
FARTHEST_M = 200.0


class Eyes(Application):
    """Words: `ask` {whom}, `allow`, `refuse` {who}, `stop` {who, whom}; `seen`, `forget`; `mark` {position}, `unmark`.

    `seen` has cubes of cells, see `scan.py`; `unmark` has an {id}. `who` is empty for the room's page: who allows that
    shows everybody what it sees.
    """

    title = "Look through my eyes"
    summary = "See what somebody else sees, walk through the room's model, point at things for everybody."
    kinds = (LOOK, SCAN, MARK)

    def said(self, stage: Stage, by: str, topic: str, data: Any) -> None:
        """A word of somebody; `by` is empty for the room's page."""
        given = data if isinstance(data, dict) else {}
        match topic:
            case "ask":
                self._ask(stage, by, given.get("whom"))
            case "allow" | "refuse" if by:
                self._answer(stage, given.get("who"), by, ON if topic == "allow" else REFUSED)
            case "stop":
                who, whom = given.get("who"), given.get("whom")
                if by in (who, whom) and (look := _look(stage, who, whom)):
                    stage.remove(look.id)
            case "seen" if by in stage.players:
                for cube in cubes_of(data):
                    self._add(stage, cube)
            case "forget" if by:
                for o in _of(stage, SCAN):
                    stage.remove(o.id)
            case "mark":
                self._mark(stage, by, given.get("position"))
            case "unmark":
                if any(o.id == given.get("id") for o in _of(stage, MARK)):
                    stage.remove(given["id"])

    def tick(self, stage: Stage) -> None:
        """Nobody sees through the eyes of who has left, or goes on looking who has."""
        here = {"", *(member.name for member in stage.members.values() if member.here)}
        for look in _of(stage, LOOK):
            age = stage.t - look.data["since"]
            over = {ASKED: WAITS_S, REFUSED: REFUSED_S}.get(look.data["state"], float("inf"))
            if age > over or not {look.data["who"], look.data["whom"]} <= here:
                stage.remove(look.id)

    def _ask(self, stage: Stage, who: str, whom: Any) -> None:
        here = any(member.name == whom and member.here and not member.static for member in stage.members.values())
        if not here or who == whom or _look(stage, who, whom):
            return
        taken = {o.id for o in _of(stage, LOOK)}
        free = next(id_ for n in range(len(taken) + 1) if (id_ := f"look {n}") not in taken)
        data = {"who": who, "whom": whom, "state": ASKED, "since": stage.t}
        stage.create(free, LOOK, (0.0, 0.0, 0.0), data=data)

    def _answer(self, stage: Stage, who: Any, whom: str, state: str) -> None:
        look = _look(stage, who, whom)
        if look is not None and look.data["state"] == ASKED:
            stage.move(look.id, data={**look.data, "state": state, "since": stage.t})

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
        if not (isinstance(position, list) and len(position) == 3):
            return
        if not all(isinstance(v, int | float) and isfinite(v) and abs(v) < FARTHEST_M for v in position):
            return
        marks = sorted(_of(stage, MARK), key=lambda o: int(o.id.rpartition(" ")[2]))
        if len(marks) >= MOST_MARKS:
            stage.remove(marks[0].id)
        number = 1 + int(marks[-1].id.rpartition(" ")[2]) if marks else 0
        x, y, z = map(float, position)
        stage.create(f"mark {number}", MARK, (x, y, z), data={"by": by})


def _of(stage: Stage, kind: str) -> list[m.Object]:
    return [o for o in stage.objects.values() if o.kind == kind]


def _look(stage: Stage, who: Any, whom: Any) -> m.Object | None:
    """The one of that pair."""
    return next((o for o in _of(stage, LOOK) if (o.data["who"], o.data["whom"]) == (who, whom)), None)
