"""What a room refuses before anybody else sees it: settings, names and numbers that no device can mean."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Container, Mapping

import msgspec

from synchronizar.data.ranges import SOURCES
from synchronizar.errors import InputError
from synchronizar.io.recording_toml import read_user
from synchronizar.io.text import MAX_STAMP, MIN_SIGMA, is_name
from synchronizar.live.messages import LONGEST_NAME, MeasuredRange, MessageError, UserSettings

LONGEST_NAME_BYTES = 200
"""A name is a file's name, which has 255 bytes at most, ending and number included."""
MOST_ANTENNAS = 16
FARTHEST, NEAREST = 10_000.0, -1.0
"""m: no radio ranges farther; one whose delay is calibrated a little too large measures slightly less than nothing."""
_MOST_DBM = 1000.0


def check_settings(user: UserSettings) -> None:
    """By the rules of recording.toml. Raises MessageError."""
    for name in (user.name, *user.antennas):
        if not (is_name(name) and len(name) <= LONGEST_NAME and len(name.encode()) <= LONGEST_NAME_BYTES):
            raise MessageError(
                "name",
                f"{name[:LONGEST_NAME]!r} cannot be a name: 1 to {LONGEST_NAME} printable characters, no / or \\",
            )
    if len(user.antennas) > MOST_ANTENNAS:
        raise MessageError("value", f"a device has at most {MOST_ANTENNAS} antennas")
    settings = msgspec.to_builtins(user)
    settings.pop("name")
    try:
        read_user("settings", user.name, user.name, settings, user.up)
    except InputError as error:
        raise MessageError("value", str(error)) from error


def alike(name: str) -> str:
    """The same for names that people, or some computers' files, take for one: Bob, bob, and bob in wide letters."""
    return unicodedata.normalize("NFKC", name).casefold()


def is_taken(name: str, sessions: Mapping[str, int]) -> bool:
    """Whether a name is another device's already, or the one by which another's new frame is recorded (bob~2).

    `sessions`: by the names of all others, as `alike`: how often its SLAM began anew.
    """
    same = alike(name)
    numbered = re.fullmatch(r"(.+)~([0-9]{1,9})", same)
    return same in sessions or (numbered is not None and int(numbered[2]) <= sessions.get(numbered[1], -2) + 1)


def check_stamp(t: float) -> None:
    """Raises MessageError where t (s) is no moment."""
    if not abs(t) < MAX_STAMP:
        raise MessageError("value", "a stamp is a number of s, since 1970 or since the device began")


def check_range(measured: MeasuredRange, antennas: tuple[Container[str], Container[str]]) -> None:
    """A range of devices with these antennas. Raises MessageError."""
    check_stamp(measured.t)
    for antenna, known in zip((measured.antenna_a, measured.antenna_b), antennas, strict=True):
        if antenna is not None and antenna not in known:
            raise MessageError("antenna", f"there is no antenna {antenna[:LONGEST_NAME]!r}: say it in the settings")
    if measured.source is not None and measured.source not in SOURCES:
        raise MessageError("source", f"the source of a range is one of {', '.join(SOURCES)}")
    if measured.sigma is not None and not MIN_SIGMA <= measured.sigma < FARTHEST:
        raise MessageError("value", "the sigma of a range is a positive number of m")
    if any(not abs(dbm) < _MOST_DBM for dbm in (measured.rx_power, measured.fp_power) if dbm is not None):
        raise MessageError("value", "a power is a number of dBm")


def check_distance(distance: float) -> None:
    """Raises MessageError where no radio measures such a distance (m)."""
    if not NEAREST <= distance <= FARTHEST:
        raise MessageError("distance", f"a distance is {NEAREST:g} to {FARTHEST:g} m")
