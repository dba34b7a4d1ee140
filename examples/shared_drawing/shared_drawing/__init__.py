"""Everybody draws in the air, and all see it: each stroke is an object, and stays until it is wiped off."""

from __future__ import annotations

from math import isfinite
from typing import Any

from synchronizar.live.applications import Application
from synchronizar.live.stage import Stage

STROKE = "drawing stroke"
MOST_POINTS, MOST_STROKES = 150, 500


class Drawing(Application):
    """`stroke` {"id", "points": (n, 3) m in the common frame} adds to a stroke; `wipe` takes one's own away."""

    title = "Drawing"
    summary = "Draw in the air with your phone; all others see it where it is."
    kinds = (STROKE,)

    def said(self, stage: Stage, by: str, topic: str, data: Any) -> None:
        """A word of somebody's page."""
        if topic == "wipe":
            for id_, stroke in list(stage.objects.items()):
                if stroke.kind == STROKE and stroke.data["by"] == by:
                    stage.remove(id_)
        elif topic == "stroke" and by in stage.players and _are_points(data):
            self._add(stage, by, f"{by} {data['id']}"[:64], [list(map(float, point)) for point in data["points"]])

    def _add(self, stage: Stage, by: str, id_: str, points: list[list[float]]) -> None:
        known = stage.objects.get(id_)
        if known is None and sum(o.kind == STROKE for o in stage.objects.values()) < MOST_STROKES:
            stage.create(id_, STROKE, (0.0, 0.0, 0.0), data={"by": by, "points": points[:MOST_POINTS]})
        elif known is not None and known.kind == STROKE:
            stage.move(id_, data={"by": by, "points": (known.data["points"] + points)[:MOST_POINTS]})


def _are_points(data: Any) -> bool:
    points = data.get("points") if isinstance(data, dict) and isinstance(data.get("id"), int) else None
    if not isinstance(points, list):
        return False
    rows = [v for point in points if isinstance(point, list) and len(point) == 3 for v in point]
    return len(rows) == 3 * len(points) and all(isinstance(v, int | float) and isfinite(v) for v in rows)
