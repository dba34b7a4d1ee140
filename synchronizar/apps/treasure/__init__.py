"""Treasure: some hide coins on the real floor, others come and collect them, also on another day."""

from synchronizar.apps.treasure.game import Treasure

__all__ = ["Treasure"]
