"""Plots of a registration (map, residuals, each device's calibration and drift) and of a replay (timeline)."""

from synchronizar.reporting.plots.devices import draw_devices
from synchronizar.reporting.plots.files import plot
from synchronizar.reporting.plots.picture import draw
from synchronizar.reporting.plots.timeline import draw_timeline

__all__ = ["draw", "draw_devices", "draw_timeline", "plot"]
