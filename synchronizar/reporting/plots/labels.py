"""Puts names and times beside their markers so that none overlaps another, or another's marker."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

HALO = (withStroke(linewidth=2.5, foreground="white"),)
DISTANCES_PT = (7.0, 14.0, 24.0, 38.0, 56.0, 80.0)
"""From a marker to its label: the nearest that is free is taken."""
DIRECTIONS = np.radians([30.0, -30.0, 150.0, -150.0, 90.0, -90.0, 0.0, 180.0])
MARKER_PT = 5.0
"""Half the side of a marker, which no other label may cover."""


def label(ax: Axes, text: str, place: Sequence[float], colour: str, size: float, bold: bool = False) -> Annotation:
    """A label of a place (x, y), with a thin line to it; `Arrangement` says where it stands."""
    return ax.annotate(
        text,
        (place[0], place[1]),
        xytext=(DISTANCES_PT[0], DISTANCES_PT[0]),
        textcoords="offset points",
        color=colour,
        fontsize=size,
        fontweight="bold" if bold else "normal",
        va="center",
        path_effects=HALO,
        arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.6, "alpha": 0.6, "shrinkA": 0.0, "shrinkB": 3.0},
        zorder=6,
    )


class Arrangement(Artist):
    """Moves labels when the axes are drawn, right before them: only then it is known how large everything is."""

    def __init__(self, labels: Sequence[Annotation]) -> None:
        super().__init__()
        self._labels = labels
        self.set_zorder(5.9)
        self.set_in_layout(False)

    def draw(self, renderer: RendererBase) -> None:
        """Place each label in the order given, the first ones nearest to their markers."""
        if self.axes is None:
            return
        point = float(np.asarray(renderer.points_to_pixels(1.0)).item())
        inside = self.axes.get_window_extent(renderer)
        marks = [tuple(self.axes.transData.transform(one.xy).tolist()) for one in self._labels]
        half = MARKER_PT * point
        taken = [Bbox.from_extents(x - half, y - half, x + half, y + half) for x, y in marks]
        for one, mark in zip(self._labels, marks, strict=True):
            width, height = _size(one, renderer)
            for offset, side, box in _spots(mark, width, height, point):
                free = not any(box.overlaps(other) for other in taken)
                if free and inside.contains(*box.min) and inside.contains(*box.max):
                    one.set(ha=side)
                    one.xyann = offset
                    taken.append(box)
                    break
            else:  # no room at all: where it was
                taken.append(one.get_window_extent(renderer))


def _size(one: Annotation, renderer: RendererBase) -> tuple[float, float]:
    """Width and height of a label's text, in pixels."""
    width, height, _ = renderer.get_text_width_height_descent(one.get_text(), one.get_fontproperties(), ismath=False)
    return width, height


def _spots(
    mark: Sequence[float], width: float, height: float, point: float
) -> Iterator[tuple[tuple[float, float], str, Bbox]]:
    """Where a label may stand, the best first: offset (points), which of its sides that is, box (pixels)."""
    for distance in DISTANCES_PT:
        for direction in DIRECTIONS:
            dx, dy = distance * float(np.cos(direction)), distance * float(np.sin(direction))
            side = "left" if dx > 1.0 else "right" if dx < -1.0 else "center"
            x, y = mark[0] + dx * point, mark[1] + dy * point
            left = x - {"left": 0.0, "center": 0.5, "right": 1.0}[side] * width
            yield (dx, dy), side, Bbox.from_extents(left, y - 0.6 * height, left + width, y + 0.6 * height)
