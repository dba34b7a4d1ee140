"""The live room: devices join, walk, and are in one frame. `Client` and `BlockingClient` are what programs join by."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from synchronizar.live.blocking import BlockingClient
    from synchronizar.live.client import Client

__all__ = ["BlockingClient", "Client"]

_HOMES = {"BlockingClient": "blocking", "Client": "client"}


def __getattr__(name: str) -> Any:
    """Loaded when it is asked for: the extra `live` need not be there for what does without."""
    if name not in _HOMES:
        raise AttributeError(name)
    return getattr(import_module(f"synchronizar.live.{_HOMES[name]}"), name)
