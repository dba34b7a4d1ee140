"""Catch: a ball goes from hand to hand, and the room counts how often."""

from synchronizar.apps.catch.game import Catch

__all__ = ["Catch"]
