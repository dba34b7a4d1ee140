"""A picture of what happened: who walked where, how sure that is, and which ranges it rests on."""

from synchronizar.plots.picture import draw, plot

__all__ = ["draw", "plot"]
