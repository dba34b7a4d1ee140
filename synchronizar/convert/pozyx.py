"""Reads pozyx logs: see `uwb_logs`."""

from synchronizar.convert.uwb_logs import read_pozyx as read
from synchronizar.convert.uwb_logs import recognises_pozyx as recognises

__all__ = ["read", "recognises"]
