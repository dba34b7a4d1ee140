"""Look through my eyes: others' views in place, what surrounds everybody in one model, and marks on it."""

from synchronizar.apps.eyes.game import Eyes

__all__ = ["Eyes"]
