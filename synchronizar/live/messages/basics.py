"""The protocol's version and limits, the words that stand for the room itself, and the error of a bad message."""

from __future__ import annotations

PROTOCOL = 1
"""Version of all of this; a client that speaks another is refused with both numbers."""
ROOM = "room"
"""In whose name the room itself takes part in WebRTC; no device can have it."""
APP = "app"
"""In whose name the room's application speaks and holds objects; no device can have it."""
LONGEST_NAME = 64
MOST_USERS = 64
"""Users that one connection may host."""
MOST_RANGES = 512
"""Ranges in one message."""
LARGEST_MESSAGE = 64 * 1024
"""Bytes of one message of a client, text or binary; what a room says is as large as the room."""
LARGEST_DATA = 8 * 1024
"""Bytes of an object's or a said message's `data`, as JSON."""

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class MessageError(ValueError):
    """A message that is refused. `reason` is a word that is counted, the text one sentence."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason
