"""The live room: devices join, walk, and are in one frame. `Client` is what programs join by."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from synchronizar.live.client import Client

__all__ = ["Client"]


def __getattr__(name: str) -> Any:
    """Loaded when it is asked for: the extra `live` need not be there for what does without."""
    if name != "Client":
        raise AttributeError(name)
    from synchronizar.live.client import Client

    return Client
