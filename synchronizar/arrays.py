"""Array types for signatures, and read-only arrays for frozen dataclasses."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Array = NDArray[np.float64]
Indices = NDArray[np.int32]
Mask = NDArray[np.bool_]


def freeze_arrays(holder: DataclassInstance) -> None:
    """Replace each field of a frozen dataclass, all of them arrays, by a read-only view."""
    for f in fields(holder):
        view = getattr(holder, f.name).view()
        view.flags.writeable = False
        object.__setattr__(holder, f.name, view)
