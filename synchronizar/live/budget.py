"""How much somebody may still say: refilled evenly, so that a burst is heard and a flood is not."""

from __future__ import annotations

from collections import Counter
from ipaddress import ip_address

WORDS_A_SECOND, BYTES_A_SECOND = 300, 128 * 1024
"""From a connection, and as many for each of its devices."""
MEASURED_A_SECOND = 1000
"""Poses and ranges, of each device; and ranges of each module."""
HANDED_ON_A_SECOND, BYTES_HANDED_ON_A_SECOND = 100, 64 * 1024
"""What a connection says to others, each of whom is told all of it."""
MOST_ADDRESSES = 10_000
"""Addresses that are counted within a minute; where there are more, all that are new have to wait for the next."""


class Budget:
    """Units that may be spent."""

    def __init__(self, a_second: float, now: float, burst: float | None = None) -> None:
        """`burst`: how many may be spent at once; None: what two seconds refill."""
        self._a_second = a_second
        self._burst = 2.0 * a_second if burst is None else burst
        self._left, self._at = self._burst, now

    def take(self, now: float, units: float = 1.0) -> bool:
        """Spend some; False, and nothing is spent, where so many are not left."""
        self._left = min(self._burst, self._left + self._a_second * max(0.0, now - self._at))
        self._at = now
        if units > self._left:
            return False
        self._left -= units
        return True


class Allowance:
    """What one connection may say, at this moment."""

    def __init__(self, devices: int, now: float) -> None:
        self._words = Budget(WORDS_A_SECOND * (1 + devices), now)
        self._bytes = Budget(BYTES_A_SECOND * (1 + devices), now)
        self._measured = Budget(MEASURED_A_SECOND * max(1, devices), now)
        self._handed_on = Budget(HANDED_ON_A_SECOND, now)
        self._handed_on_bytes = Budget(BYTES_HANDED_ON_A_SECOND, now)

    def word(self, now: float, size: int) -> bool:
        """One more word, of so many bytes."""
        return self._words.take(now) and self._bytes.take(now, size)

    def measured(self, now: float, count: int) -> bool:
        """So many poses or ranges more."""
        return self._measured.take(now, count)

    def handed_on(self, now: float, size: int) -> bool:
        """One more word that others are told."""
        return self._handed_on.take(now) and self._handed_on_bytes.take(now, size)


class Tally:
    """What each network address did within this minute; an IPv6 network of 64 bits, which one device has, is one."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._counted: Counter[str] = Counter()
        self._minute = 0

    def full(self, address: str, now: float) -> bool:
        """Whether it did so as often as it may, or too many addresses do it at all."""
        if (minute := int(now // 60.0)) != self._minute:
            self._minute = minute
            self._counted.clear()
        known = _network(address)
        return self._counted[known] >= self._most if known in self._counted else len(self._counted) >= MOST_ADDRESSES

    def count(self, address: str) -> None:
        """It did so once more."""
        self._counted[_network(address)] += 1


def _network(address: str) -> str:
    try:
        parsed = ip_address(address.partition("%")[0])
    except ValueError:
        return address
    return address if parsed.version == 4 or parsed.ipv4_mapped else f"{int(parsed) >> 64:x}/64"
