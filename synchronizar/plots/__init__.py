"""Pictures of what happened: who walked where, how sure that is, which ranges it rests on, what is wrong with whom."""

from synchronizar.plots.devices import draw_devices
from synchronizar.plots.files import plot
from synchronizar.plots.picture import draw

__all__ = ["draw", "draw_devices", "plot"]
