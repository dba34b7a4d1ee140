"""Who sees through whose eyes: asked for, allowed, ended by either. For any application whose pages show views.

Nobody is seen who has not said yes. Pictures themselves do not pass here: who is seen sends them to those it has
allowed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from synchronizar.live import messages as m
from synchronizar.live.stage import Stage

LOOK = "look"
ASKED, ON, REFUSED = "asked", "on", "refused"
WAITS_S = 60.0
"""s: a question that nobody answers is gone."""
REFUSED_S = 10.0
"""s: so long whoever was refused does not ask again."""


class Looks:
    """Words: `ask` {whom}, `allow`, `refuse` {who}, `stop` {who, whom}. All of it stands as objects.

    `who` is empty for the room's page: who allows that shows everybody what it sees.
    """

    def said(self, stage: Stage, by: str, topic: str, data: Any) -> None:
        """A word of somebody; other words than these are left alone."""
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

    def tick(self, stage: Stage) -> None:
        """Nobody sees through the eyes of who has left, or goes on looking who has."""
        here = {"", *(member.name for member in stage.members.values() if member.here)}
        for look in looks_of(stage.objects):
            age = stage.t - look.data["since"]
            over = {ASKED: WAITS_S, REFUSED: REFUSED_S}.get(look.data["state"], float("inf"))
            if age > over or not {look.data["who"], look.data["whom"]} <= here:
                stage.remove(look.id)

    def _ask(self, stage: Stage, who: str, whom: Any) -> None:
        here = any(member.name == whom and member.here and not member.static for member in stage.members.values())
        if not here or who == whom or _look(stage, who, whom):
            return
        taken = {o.id for o in looks_of(stage.objects)}
        free = next(id_ for n in range(len(taken) + 1) if (id_ := f"look {n}") not in taken)
        data = {"who": who, "whom": whom, "state": ASKED, "since": stage.t}
        stage.create(free, LOOK, (0.0, 0.0, 0.0), data=data)

    def _answer(self, stage: Stage, who: Any, whom: str, state: str) -> None:
        look = _look(stage, who, whom)
        if look is not None and look.data["state"] == ASKED:
            stage.move(look.id, data={**look.data, "state": state, "since": stage.t})


def looks_of(objects: Mapping[str, m.Object], whom: str | None = None) -> list[m.Object]:
    """Those through the eyes of `whom`, or all."""
    return [o for o in objects.values() if o.kind == LOOK and whom in (None, o.data["whom"])]


def _look(stage: Stage, who: Any, whom: Any) -> m.Object | None:
    """The one of that pair."""
    return next((o for o in looks_of(stage.objects) if (o.data["who"], o.data["whom"]) == (who, whom)), None)
