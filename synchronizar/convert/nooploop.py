"""Reads nooploop logs: see `uwb_logs`."""

from synchronizar.convert.uwb_logs import read_nooploop as read
from synchronizar.convert.uwb_logs import recognises_nooploop as recognises

__all__ = ["read", "recognises"]
