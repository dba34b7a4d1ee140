"""What a user may say about a source: names, units, axes, which messages are what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

LENGTH_UNITS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "um": 1e-6, "ft": 0.3048, "in": 0.0254}
"""m in one of each."""
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""s in one of each."""
_BEYOND_S = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
ANGLE_UNITS = ("rad", "deg")
STAMPS = ("header", "log")
"""Which stamp of a message counts: its own header's, or when it was written to the file."""


def time_unit_by_size(value: float) -> str:
    """The unit of a stamp that does not say it: numbers that can be no seconds since 1970 are of a smaller one."""
    return next((unit for beyond, unit in _BEYOND_S if abs(value) > beyond), "s")


@dataclass(frozen=True)
class Asked:
    """The options of `convert` for what comes in; None: what the format says, or what its importer finds likely."""

    user: str | None = None
    """Whose track a file of one track is; None: by the file's name."""
    world: str | None = None
    """Axes of the frame that positions are in, by name or letters (`axes.py`)."""
    body: str | None = None
    """Axes of the device that attitudes turn."""
    length_unit: str | None = None
    """Of positions."""
    range_unit: str | None = None
    time_unit: str | None = None
    time_offset: float = 0.0
    """s: added to all stamps."""
    rate: float | None = None
    """Hz: lines of a log that has no stamps."""
    angle_unit: str | None = None
    quaternion: str | None = None
    """wxyz or xyzw."""
    stamps: str | None = None
    """One of STAMPS."""
    sigma: bool = False
    """Whether what the source says of its ranges' noise is taken."""
    map: Path | None = None
    """A TOML file that says what topics, columns and radios are."""
    topics: Sequence[str] = ()
    """`TOPIC key=value ...`: the same for one topic."""
    columns: Sequence[tuple[str, str]] = ()
    """`name=column`: the same for the columns of a table."""
    renamed: Sequence[tuple[str, str]] = ()
    """Names in the source and what they are called in the recording."""
    static: Sequence[str] = ()
    """Radios that stand still."""
    left_out: Sequence[str] = ()
    """Names in the source that are not taken."""
