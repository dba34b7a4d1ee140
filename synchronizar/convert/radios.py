"""Whose radios are: by the topics in which they measure, by names and numbers."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Sequence
from typing import Protocol

from synchronizar.convert.guess import RangeRole
from synchronizar.convert.names import matched, words_of

_RADIOS = 4
"""That one device carries, at most: where only one is left that may carry them, they are its."""


class RangesOfTopic(Protocol):
    """A topic of ranges, and who measured in it."""

    @property
    def role(self) -> RangeRole:
        """What the topic is."""

    @property
    def a(self) -> Collection[str]:
        """Radios that measured."""

    @property
    def b(self) -> Collection[str]:
        """Radios to which they measured."""


def carriers(
    topics: Sequence[RangesOfTopic], users: Collection[str], said: Collection[str], taken: Collection[str]
) -> dict[str, str]:
    """The device that carries each radio, where that can be known.

    `users`: devices; `said`: radios of which it is said whose they are, `taken`: and whose that is.
    """
    measuring = {name for topic in topics for name in topic.a}
    measured = {name for topic in topics for name in topic.b}
    radios = sorted((measuring | measured) - set(said))
    known = set(users)
    of = {radio: user for radio, user in _owned(topics, known - set(taken)).items() if radio in radios}
    of |= matched([r for r in radios if r not in of], sorted(known - set(taken) - set(of.values())))
    strangers = {radio for radio in radios if radio not in of}
    free = sorted(known - set(of.values()) - set(taken))
    if len(free) == 1 and len(measuring) <= _RADIOS and measuring <= strangers - measured:
        of |= dict.fromkeys(measuring, free[0])
    return of


def _owned(topics: Sequence[RangesOfTopic], users: set[str]) -> dict[str, str]:
    """Whose radios are that measure in the topics of one device alone, and not of more than a few."""
    measuring: dict[str, set[str]] = defaultdict(set)
    for topic in topics:
        if topic.role.a.startswith("="):
            continue
        whose = [user for user in users if user.lower() in map(str.lower, words_of(topic.role.topic.name))]
        for radio in set(topic.a):
            measuring[radio].add(whose[0] if len(whose) == 1 else "")
    owners = {radio: next(iter(of)) for radio, of in measuring.items() if len(of) == 1 and "" not in of}
    counts = Counter(owners.values())
    return {radio: user for radio, user in owners.items() if counts[user] <= _RADIOS}
