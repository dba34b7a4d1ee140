"""Applications: what people do together in a room. They are found by their entry points; no room knows one by name."""

from __future__ import annotations

from contextlib import suppress
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar

from synchronizar.errors import InputError
from synchronizar.live.stage import Stage

GROUP = "synchronizar.apps"
"""Of entry points: a name of one's own, and a subclass of Application."""


class Application:
    """One game or tool, in one room. It sees and changes the room by its stage alone, and keeps no other time.

    What has to outlive it stands in the data of its objects: it may be begun again in the middle.
    """

    title: ClassVar[str]
    summary: ClassVar[str]
    """One sentence for who chooses."""
    kinds: ClassVar[tuple[str, ...]] = ()
    """Kinds of objects that its pages draw themselves."""

    def begin(self, stage: Stage) -> None:
        """It is in the room, which may have its objects already."""

    def said(self, stage: Stage, by: str, topic: str, data: Any) -> None:
        """Somebody said a word to it; `by` is empty for who only looks."""

    def tick(self, stage: Stage) -> None:
        """About thirty times a second, whenever everybody's poses have come."""


def installed() -> dict[str, EntryPoint]:
    """All applications that are installed, by name."""
    return {point.name: point for point in sorted(entry_points(group=GROUP))}


def application(name: str) -> type[Application]:
    """Raises InputError where there is none of that name, or it cannot be loaded."""
    known = installed()
    if name not in known:
        raise InputError("--app", f"there is no application {name!r}; there are: {', '.join(known) or 'none'}")
    try:
        found = known[name].load()
    except (ImportError, AttributeError) as error:
        raise InputError("--app", f"{name} cannot be loaded: {error}") from error
    if not (isinstance(found, type) and issubclass(found, Application)):
        raise InputError("--app", f"{name} is no subclass of synchronizar.live.applications.Application")
    return found


@cache
def loaded() -> dict[str, type[Application]]:
    """All that can be loaded, by name."""
    found = {}
    for name in installed():
        with suppress(InputError):
            found[name] = application(name)
    return found


def pages_of(app: type[Application]) -> Path:
    """The folder beside its module with what browsers load: `phone.js` and `room.js`, either or none."""
    package = app.__module__ if "." not in app.__module__ else app.__module__.rpartition(".")[0]
    return Path(str(files(package))) / "pages"
