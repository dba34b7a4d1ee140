"""A mark for tests that run the modules' firmware: they are skipped where it is not built, but never in CI."""

from __future__ import annotations

import os

import pytest

from synchronizar.errors import InputError
from synchronizar.simulation import air


def _is_built() -> bool:
    try:
        air.program()
    except InputError:
        return False
    return True


needs_air = pytest.mark.skipif(
    not _is_built() and "CI" not in os.environ, reason="synchronizar-air is not built (-DFIRMWARE=ON)"
)
