"""Stamps that leap far away from their neighbours, set aside as they come."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Generic, NamedTuple, TypeVar

from synchronizar.parameters import Parameters

Item = TypeVar("Item")


class Admitted(NamedTuple, Generic[Item]):
    """What may be used now that one more has come."""

    items: Sequence[tuple[float, Item]]
    """Stamps (s) and what they stamp: nothing while it is not known whether time leapt."""
    aside: Sequence[float] = ()
    """s: stamps of what will never be used."""
    anew: bool = False
    """Whether everything admitted before was stray: a few, far away from what goes on now."""


class StampGuard(Generic[Item]):
    """Holds back what is stamped far away from what came before, until the next ones say whether time is there.

    Where more than a few follow one another there, time leapt: a gap. Where the next is stamped as before, or they lie
    here and there, they are stray: one stamped a day ahead does not make it tomorrow. The first few are stray where
    time leaps right after them: a device that stamps its first pose 0, and the others since 1970.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._gap, self._few = parameters.diagnosis.stray_gap, parameters.diagnosis.stray_few
        self.last = -float("inf")
        """s: the latest stamp that was admitted."""
        self.count = 0
        """How many were admitted."""
        self.held: list[tuple[float, Item]] = []

    def admit(self, t: float, item: Item) -> Admitted[Item]:
        """One more, and what may be used now because of it; `t` is finite."""
        if not self.count or abs(t - self.last) <= self._gap:
            aside = [stamp for stamp, _ in self.held]
            self.held.clear()
            return self._admitted([(t, item)], aside)
        self.held.append((t, item))
        if len(self.held) <= self._few:
            return Admitted(())
        stamps = sorted(stamp for stamp, _ in self.held)
        if any(later - earlier > self._gap for earlier, later in pairwise(stamps)):
            stray, _ = self.held.pop(0)
            return Admitted((), (stray,))
        items = sorted(self.held, key=lambda each: each[0])
        self.held.clear()
        if self.count <= self._few:
            self.last, self.count = -float("inf"), 0
            return self._admitted(items, [], anew=True)
        if stamps[0] < self.last:
            return Admitted((), stamps)
        return self._admitted(items, [])

    def settle(self) -> Admitted[Item]:
        """What is still held when nothing more comes: stray."""
        stamps = [stamp for stamp, _ in self.held]
        self.held.clear()
        return Admitted((), stamps)

    def _admitted(self, items: list[tuple[float, Item]], aside: list[float], anew: bool = False) -> Admitted[Item]:
        self.last = max(self.last, items[-1][0])
        self.count += len(items)
        return Admitted(items, aside, anew)
