"""Where things stand beside the tests."""

from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
SHARED = REPOSITORY.parent / "shared"
"""Recordings that stand beside a checkout and are not part of it."""
