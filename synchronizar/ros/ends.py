"""Whose radios ranges are between, and which antennas."""

from __future__ import annotations

from collections.abc import Collection

from synchronizar.convert.asked import Asked
from synchronizar.convert.mapping import Mapped
from synchronizar.convert.radios import carriers
from synchronizar.live import messages as m
from synchronizar.ros.listening import HeardRange, RangeTopic


class Ends:
    """Of the topics of one rosbridge."""

    def __init__(self, asked: Asked, said: Mapped) -> None:
        self._asked, self._said = asked, said
        self._renamed = dict(asked.renamed)
        self._carriers: dict[str, str] = {}
        self._known: tuple[int, frozenset[str]] = (0, frozenset())

    def measured(
        self, heard: HeardRange, topics: Collection[RangeTopic], here: Collection[str]
    ) -> m.MeasuredRange | None:
        """The range by a room's names and its own stamp; None where an end is of nobody. `here`: the room's devices."""
        self._look(topics, here)
        (a, antenna_a), (b, antenna_b) = self._end(heard.a), self._end(heard.b)
        if a == b or not {a, b} <= set(here):
            return None
        optional = dict(heard.optional)
        antennas = {"antenna_a": antenna_a or None, "antenna_b": antenna_b or None}
        optional |= {name: own for name, own in antennas.items() if own is not None}
        return m.MeasuredRange(heard.stamp, a, b, heard.distance, **optional)

    def unknown(self, heard: HeardRange, here: Collection[str]) -> list[str]:
        """Which of its radios nobody in the room carries."""
        return [radio for radio in (heard.a, heard.b) if self._end(radio)[0] not in here]

    def _end(self, radio: str) -> tuple[str, str]:
        """Device and antenna."""
        if (said := self._said.radios.get(radio)) is not None:
            return said.user, said.antenna
        if radio in self._renamed:
            return self._renamed[radio], ""
        return self._carriers.get(radio, radio), ""

    def _look(self, topics: Collection[RangeTopic], here: Collection[str]) -> None:
        """By names and numbers, whenever there are more radios or devices."""
        known = sum(len(topic.a) + len(topic.b) for topic in topics), frozenset(here)
        if known == self._known:
            return
        self._known = known
        said = {*self._said.radios, *self._renamed}
        taken = {*(radio.user for radio in self._said.radios.values()), *self._renamed.values()}
        self._carriers = carriers(list(topics), here, said, taken)
