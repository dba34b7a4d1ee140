"""What text logs of ranging modules have in common: when a line was logged, and ranges in the module's unit.

The time of a line is the stamp before what is read in it: s, ms, us or ns since 1970, 2024-05-01T12:00:00.5, or
12:00:00.5. Without one it is the module's own clock, and without that so many lines a second (`--rate`).
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

from synchronizar.convert.asked import LENGTH_UNITS, TIME_UNITS, Asked, time_unit_by_size
from synchronizar.convert.imported import Imported
from synchronizar.errors import InputError

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
OWN_CLOCK = "stamps are the module's own clock (--time-offset shifts them to the tracks')"
_DATE = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d(?:[.,]\d+)?)(Z|[+-]\d\d:?\d\d)?")
_TIME_OF_DAY = re.compile(r"(\d\d):(\d\d):(\d\d(?:[.,]\d+)?)")
_NUMBER = re.compile(NUMBER)
_DAY_S = 86400.0


class Log:
    """A log as it is read."""

    def __init__(self, path: Path, asked: Asked, unit: str) -> None:
        """`unit` is that of the module's distances, where none was asked for."""
        self.imported = Imported()
        self.me = asked.user or path.stem
        """Who ranges, where the log does not say it."""
        self.metres = LENGTH_UNITS[asked.range_unit or unit]
        """In one of the unit."""
        self._path, self._asked = path, asked
        self._timed = 0
        self._day, self._newest = 0.0, 0.0

    def add(self, t: float, a: str, b: str, distance: float, **powers: float) -> None:
        """Add a range at t (s), in the log's unit; powers in dBm."""
        self.imported.ranges.add(t, a, b, self.metres * distance, **powers)

    def time(self, line: int, before: str, own: float | None = None) -> float:
        """s: when a line was logged, by what stands `before` its ranges, or by the module's `own` clock (s).

        Raises InputError where nothing tells.
        """
        self._timed += 1
        stamp = self._stamp(before)
        if stamp is not None:
            return stamp
        if own is not None:
            self.imported.note(OWN_CLOCK)
            return own
        if self._asked.rate is not None:
            return (self._timed - 1) / self._asked.rate
        raise InputError(
            self._path, "has no time: log a stamp before each line, or say --rate HZ (and --time-offset)", line
        )

    def read(self, like: str, skipped: int = 0) -> Imported:
        """All that was in it, but for so many lines. Raises InputError, which says what a range is like, for none."""
        if not len(self.imported.ranges):
            raise InputError(self._path, f"has no range: one is like {like}")
        if skipped:
            self.imported.note(f"{skipped} lines of {self._path.name} are no ranges and skipped")
        return self.imported

    def _stamp(self, text: str) -> float | None:
        if found := _DATE.search(text):
            zone = (found[3] or "Z").replace("Z", "+00:00")
            try:
                moment = datetime.fromisoformat(f"{found[1]}T{found[2].replace(',', '.')}{zone}")
            except ValueError:
                return None
            if found[3] is None:
                self.imported.note("dates without a zone are taken for UTC")
            return moment.astimezone(UTC).timestamp()
        if found := _TIME_OF_DAY.search(text):
            self.imported.note("stamps are times of the day, without a date")
            return self._since_first_midnight(
                3600.0 * float(found[1]) + 60.0 * float(found[2]) + float(found[3].replace(",", "."))
            )
        found = _NUMBER.search(text)
        if found is None:
            return None
        value = float(found[0])
        return value * TIME_UNITS[self._asked.time_unit or time_unit_by_size(value)]

    def _since_first_midnight(self, t: float) -> float:
        """A time of the day (s) of which the next day's follows the day's before."""
        if t < self._newest - 0.5 * _DAY_S:
            self._day += _DAY_S
        self._newest = t
        return self._day + t
