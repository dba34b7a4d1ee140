"""Which stamps of messages count: their own, or when they were logged."""

from __future__ import annotations

from array import array
from typing import Protocol

import numpy as np

from synchronizar.arrays import Array
from synchronizar.convert.asked import Asked
from synchronizar.convert.assembling import listed
from synchronizar.convert.imported import Imported

_CLOCKS_AGREE = 1.0
"""s: stamps that differ more from when they were logged than others' do are of another clock."""


class Stamped(Protocol):
    """The messages of a topic."""

    @property
    def topic(self) -> str:
        """Its name."""
        ...

    @property
    def logged(self) -> array[float]:
        """When each was logged, s."""
        ...

    @property
    def own(self) -> array[float]:
        """Its own stamp, s; NaN where it has none."""
        ...


class MessageClock:
    """One clock for all topics where that can be: messages' own, if they agree."""

    def __init__(self, topics: list[Stamped], asked: Asked, imported: Imported) -> None:
        self._by_log = asked.stamps == "log"
        usable = {id(t): np.array(t.own) - np.array(t.logged) for t in topics if len(t.own)}
        usable = {k: d for k, d in usable.items() if np.isfinite(d).all()}
        self._medians = {k: float(np.median(d)) for k, d in usable.items()}
        zero = {id(t) for t in topics if len(t.own) and not np.any(t.own)}
        weights = {id(t): len(t.own) for t in topics}
        candidates = sorted((m, weights[k]) for k, m in self._medians.items() if k not in zero)
        self._common = 0.0
        if candidates and not self._by_log:
            support = [sum(w for m, w in candidates if abs(m - of) < _CLOCKS_AGREE) for of, _ in candidates]
            self._common = candidates[int(np.argmax(support))][0]
        self._own = {k for k, m in self._medians.items() if k not in zero and abs(m - self._common) < _CLOCKS_AGREE}
        if self._by_log or asked.stamps == "header":
            self._own = set() if self._by_log else set(self._medians)
            return
        if abs(self._common) > _CLOCKS_AGREE and self._own:
            imported.note(
                f"messages' own stamps lie {self._common:.6g} s from when they were logged: their own are taken"
            )
        strange = [t.topic for t in topics if len(t.own) and id(t) not in self._own]
        if strange and self._own:
            imported.note(
                f"{listed(sorted(strange))}: no stamps of their own, or of another clock than the rest's, so they have"
                " the time at which they were logged (--stamps header takes their own)"
            )
        elif strange:
            self._common = 0.0
            imported.note("messages have no stamps of their own: they have the time at which they were logged")

    def stamps(self, topic: Stamped) -> Array:
        """(n,) s: the stamps of a topic's messages that count."""
        if id(topic) in self._own:
            return np.array(topic.own)
        return np.array(topic.logged) + (0.0 if self._by_log else self._common)

    def shift(self, topic: Stamped) -> float:
        """s: what makes of stamps inside a topic's messages those that count."""
        if id(topic) in self._own or id(topic) not in self._medians:
            return 0.0
        return (0.0 if self._by_log else self._common) - self._medians[id(topic)]
