"""Pictures of what happened: who walked where, how sure that is, which ranges it rests on, what is wrong with whom.

Of a replay: what was known when.
"""

from synchronizar.plots.devices import draw_devices
from synchronizar.plots.files import plot
from synchronizar.plots.picture import draw
from synchronizar.plots.timeline import draw_timeline

__all__ = ["draw", "draw_devices", "draw_timeline", "plot"]
