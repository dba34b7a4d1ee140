"""Reads dwm1001 logs: see `uwb_logs`."""

from synchronizar.convert.uwb_logs import read_dwm1001 as read
from synchronizar.convert.uwb_logs import recognises_dwm1001 as recognises

__all__ = ["read", "recognises"]
