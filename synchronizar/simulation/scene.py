"""Settings of a simulated walk: walkers, their SLAM, their radios."""

from __future__ import annotations

import math
from dataclasses import dataclass

from synchronizar.data.ranging_rate import papers_rate_hz
from synchronizar.errors import InputError

WALKS = ("free", "line", "still")
LINKS = ("all", "star", "chain")
UPS = ("z", "y")
SCHEMES = ("one-to-n", "all-pairs", "polling")
"""Which module sends when: firmware/core/timetable.h."""

SHORTEST_DETOUR_M = 0.3
"""m: least extra length of an NLOS signal."""

_AT_LEAST = {
    "users": 2,
    "seed": 0,
    "height_spread": 0.0,
    "height_bob": 0.0,
    "sigma": 0.0,
    "late_mean": SHORTEST_DETOUR_M,
    "bias_sigma": 0.0,
    "clock_offset_sigma": 0.0,
    "scale_sigma": 0.0,
    "drift_m_per_sqrt_s": 0.0,
    "drift_rad_per_sqrt_s": 0.0,
    "jumps": 0,
    "jump_m": 0.0,
    "jump_rad": 0.0,
    "late_joiners": 0,
    "static_radios": 0,
    "antennas": 0,
}
_ABOVE_ZERO = ("seconds", "speed", "area", "track_rate_hz", "late_burst_s")
_SHARES = ("late_share", "loss")


@dataclass(frozen=True)
class Scene:
    """The settings of a simulated walk; the defaults are a clean one. Raises InputError that names the option."""

    users: int = 2
    """How many people walk with a device: phone0, phone1, ..."""
    seconds: float = 12.0
    """s: how long the ranging goes on."""
    seed: int = 0
    """The same scene with the same seed is the same to the last bit."""
    walk: tuple[str, ...] = ("free",)
    """How each user moves, cycled: `free` from one random place to the next, `line` to and fro, `still`."""
    speed: float = 1.0
    """m/s, on average, of those who walk."""
    area: float = 6.0
    """m: side of the square room."""
    height: float = 1.4
    """m: of the devices above the floor."""
    height_spread: float = 0.1
    """m, 1 sigma: of each device's own height about `height`."""
    height_bob: float = 0.05
    """m: amplitude of the up and down of each step; once to twice as much comes and goes slowly. 0: level walks."""
    track_rate_hz: float = 30.0
    """Poses a second in each track."""
    rate_hz: float | None = None
    """Rounds a second, in each of which every pair ranges once; None: 1000 / (80 + 21 (k - 1)) for k devices."""
    sigma: float = 0.1
    """m, 1 sigma: noise of a range."""
    late_share: float = 0.0
    """0 to 1: expected share of ranges without line of sight, which are too long. They come in bursts, pair by pair."""
    late_burst_s: float = 1.0
    """s: how long a pair's line of sight stays blocked, on average."""
    late_mean: float = 1.0
    """m: by how much late ranges are too long, on average over the bursts; at least 0.3."""
    loss: float = 0.0
    """0 to 1: share of ranges that fail."""
    bias_sigma: float = 0.0
    """m, 1 sigma: of each radio's bias b; a range is too long by b_i + b_j."""
    clock_offset_sigma: float = 0.0
    """s, 1 sigma: of each device's own stamp minus the range clock's stamp of the same event."""
    scale_sigma: float = 0.0
    """1 sigma: of log s, where metric lengths are s times those of the device's own frame."""
    drift_m_per_sqrt_s: float = 0.0
    """m/sqrt(s): random walk of SLAM's position, on each axis."""
    drift_rad_per_sqrt_s: float = 0.0
    """rad/sqrt(s): random walk of SLAM's heading."""
    jumps: int = 0
    """How often each user's SLAM re-localises."""
    jump_m: float = 0.5
    """m: by how much the position jumps, to any side."""
    jump_rad: float = 0.2
    """rad: by how much the heading jumps, to the left or right."""
    late_joiners: int = 0
    """How many users, the last ones, appear only in the second half."""
    static_radios: int = 0
    """How many radios stand still in the room besides: radio0, radio1, ... They do not range with one another."""
    links: str = "all"
    """Who ranges: `all` pairs, a `star` about the first user, a `chain` in which the last user also ranges radios."""
    antennas: int = 0
    """How many antennas each user's device has, within 0.15 m of its origin; 0: one at the origin."""
    power: bool = False
    """Whether ranges tell the received power, in all and of the first path; those of modules always do."""
    up: str = "z"
    """`z` or `y`: which axis points up in the tracks that are saved. In memory it is always z."""

    def __post_init__(self) -> None:
        for name, least in _AT_LEAST.items():
            value = getattr(self, name)
            _require(least <= value < math.inf, name, f"must be a number of at least {least}, not {value}")
        for name in _ABOVE_ZERO:
            value = getattr(self, name)
            _require(0.0 < value < math.inf, name, f"must be a number above 0, not {value}")
        for name in _SHARES:
            value = getattr(self, name)
            _require(0.0 <= value <= 1.0, name, f"must be between 0 and 1, not {value}")
        _require(math.isfinite(self.height), "height", f"must be a number, not {self.height}")
        _require(self.round_hz > 0.0, "rate_hz", f"must be above 0, not {self.rate_hz}")
        _require(
            self.late_joiners < self.users, "late_joiners", f"must leave somebody of {self.users} who is there early"
        )
        _require(bool(self.walk), "walk", f"needs one of {', '.join(WALKS)}")
        for name, known in (("walk", WALKS), ("links", LINKS), ("up", UPS)):
            value = getattr(self, name)
            for word in (value,) if isinstance(value, str) else value:
                _require(word in known, name, f"'{word}' is none of {', '.join(known)}")

    @property
    def round_hz(self) -> float:
        """Hz: rounds of ranging."""
        if self.rate_hz is not None:
            return self.rate_hz
        partners = self.users + self.static_radios - 1
        return papers_rate_hz(partners)


def _require(fine: bool, name: str, fault: str) -> None:
    """Raise InputError with the fault of the option `name`, unless it is fine."""
    if not fine:
        raise InputError(f"--{name.replace('_', '-')}", fault)
