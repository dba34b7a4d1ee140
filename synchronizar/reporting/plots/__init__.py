"""Pictures of what happened: who walked where, how sure that is, which ranges it rests on, what is wrong with whom.

Of a replay: what was known when.
"""

from synchronizar.reporting.plots.devices import draw_devices
from synchronizar.reporting.plots.files import plot
from synchronizar.reporting.plots.picture import draw
from synchronizar.reporting.plots.timeline import draw_timeline

__all__ = ["draw", "draw_devices", "draw_timeline", "plot"]
