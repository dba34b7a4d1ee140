"""Orders to robots: be my mirror image, come, stay. What is ordered stands as an object, which the robot reads."""

from __future__ import annotations

from typing import Any

from synchronizar.apps.bodies.drive import Ground
from synchronizar.apps.looks import LOOK, Looks
from synchronizar.apps.robot.mirror import mirror_between
from synchronizar.live.applications import Application
from synchronizar.live.stage import Player, Stage, heading_of

ORDER = "robot order"


class Robots(Application):
    """Words: `robot` of a robot that is there for orders; `mirror`, `come` of a player, `stay` of anybody.

    And those of `Looks`: people see what the robot sees, and the robot what they do.
    Orders go to the robot that they name, {"robot": name}, or to the nearest one.
    """

    title = "Robot"
    summary = "A robot is your mirror image, or comes when you call it, and keeps away from everybody."
    kinds = (ORDER, LOOK)

    def __init__(self) -> None:
        self._looks = Looks()

    def tick(self, stage: Stage) -> None:
        """Who has left is seen no more."""
        self._looks.tick(stage)

    def said(self, stage: Stage, by: str, topic: str, data: Any) -> None:
        """A word of a robot or a player."""
        self._looks.said(stage, by, topic, data)
        if topic == "robot" and by:
            if order_id(by) not in stage.objects:
                stage.create(order_id(by), ORDER, (0.0, 0.0, 0.0), data={"robot": by, "do": "stay"})
        elif topic in ("mirror", "come", "stay"):
            self._order(stage, by, topic, data.get("robot") if isinstance(data, dict) else None)

    def _order(self, stage: Stage, by: str, do: str, robot: Any) -> None:
        robots = [o.data["robot"] for o in stage.objects.values() if o.kind == ORDER and o.data["robot"] != by]
        if do == "stay":
            for name in robots:
                if robot in (None, name):
                    stage.move(order_id(name), data={"robot": name, "do": "stay"})
            return
        player = stage.players.get(by)
        here = [name for name in robots if name in stage.players and robot in (None, name)]
        if player is None or not here:
            return
        name = min(here, key=lambda one: _away(stage.players[one], player))
        data: dict[str, Any] = {"robot": name, "do": do, "whom": by}
        if do == "mirror":
            data["mirror"] = list(mirror_between(ground_of(player), ground_of(stage.players[name])))
        stage.move(order_id(name), data=data)


def order_id(robot: str) -> str:
    """Of the object with its order."""
    return f"{ORDER} {robot}"[:64]


def ground_of(player: Player) -> Ground:
    """Where somebody stands and looks, on the floor of the common frame."""
    return Ground(player.position[0], player.position[1], heading_of(player.forward))


def _away(a: Player, b: Player) -> float:
    return (a.position[0] - b.position[0]) ** 2 + (a.position[1] - b.position[1]) ** 2
