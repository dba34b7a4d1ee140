"""Objects as plain values, and back: the attributes that their classes name in `KEPT`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol


class Kept(Protocol):
    """What can be saved."""

    KEPT: ClassVar[tuple[str, ...]]
    """Names of the attributes that are saved as they are."""


def kept(of: Kept) -> dict[str, Any]:
    """Its attributes by name."""
    return {name: getattr(of, name) for name in of.KEPT}


def restore_kept(to: Kept, values: Mapping[str, Any]) -> None:
    """What `kept` told of. KeyError where one is not there."""
    for name in to.KEPT:
        setattr(to, name, values[name])
