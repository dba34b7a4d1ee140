"""A program's eyes: it gives still frames to those who may look, as phones do, and gets others' the same way."""

from __future__ import annotations

import base64
import binascii
import io
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from synchronizar.apps.looks import ASKED, ON, looks_of
from synchronizar.arrays import Array
from synchronizar.live import messages as m

TOPIC = "eye"
EVERY_S = 0.5
ASKS_EVERY_S = 15.0
LARGEST = 5200
"""Bytes of a JPEG: in base64, with the rest of its word, below what a word may have."""


class View(NamedTuple):
    """What a camera sees."""

    jpeg: bytes
    half: float
    """m: half the height of what it shows at 1 m."""
    aspect: float
    """Width by height."""


class Stills:
    """Of one device of a client: whoever reads its messages gives them to `hear`, and sends what `words` has."""

    def __init__(self, name: str, see: Callable[[], View | None], through: str | None = None) -> None:
        """`see`: what the device sees now. `through`: through whose eyes it wants to look; that one has to say yes."""
        self._name, self._see, self._through = name, see, through
        self._shown = self._asked = float("-inf")
        self.seen: dict[str, View] = {}
        """The newest of those through whose eyes it looks."""

    def hear(self, word: Any) -> str | None:
        """Something that the room says; of whom there is a new view."""
        if not (isinstance(word, m.Said) and word.topic == TOPIC and isinstance(word.data, dict)):
            return None
        jpeg, half, aspect = (word.data.get(key) for key in ("jpeg", "half", "aspect"))
        if not (isinstance(jpeg, str) and isinstance(half, int | float) and isinstance(aspect, int | float)):
            return None
        try:
            self.seen[word.by] = View(base64.b64decode(jpeg, validate=True), half, aspect)
        except (binascii.Error, ValueError):
            return None
        return word.by

    def words(self, t: float, objects: Mapping[str, m.Object]) -> list[m.Say]:
        """What it has to say at `t` (s), some times a second: a program lets everybody look who asks."""
        looks = looks_of(objects, self._name)
        said = [m.Say("allow", {"who": o.data["who"]}, m.APP) for o in looks if o.data["state"] == ASKED]
        on = [o.data["who"] for o in looks if o.data["state"] == ON]
        if on and t - self._shown >= EVERY_S:
            self._shown = t
            if (view := self._see()) is not None:
                data = {"jpeg": base64.b64encode(view.jpeg).decode(), "half": view.half, "aspect": view.aspect}
                # The room's page has no address of its own: what it may see goes to everybody.
                said += [m.Say(TOPIC, data, who or None) for who in ([""] if "" in on else on)]
        asks = self._through is not None and t - self._asked >= ASKS_EVERY_S
        if asks and not any(o.data["who"] == self._name for o in looks_of(objects, self._through)):
            self._asked = t
            said.append(m.Say("ask", {"whom": self._through}, m.APP))
        return said


def jpeg_of(picture: Array) -> bytes:
    """Of (h, w, 3) bytes, as good as fits into a word."""
    from PIL import Image

    return _smallest(Image.fromarray(picture))


def shrunk(jpeg: bytes, width: int = 256) -> tuple[bytes, float]:
    """A camera's picture small enough for a word, and its width by height. Raises OSError where it is none."""
    from PIL import Image

    image = Image.open(io.BytesIO(jpeg)).convert("RGB")
    aspect = image.width / image.height
    return _smallest(image.resize((width, round(width / aspect)))), aspect


def _smallest(image: Any) -> bytes:
    for quality in (70, 50, 35, 20, 10):
        out = io.BytesIO()
        image.save(out, "JPEG", quality=quality)
        if out.tell() <= LARGEST:
            break
    return out.getvalue()
