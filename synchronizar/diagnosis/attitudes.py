"""Attitudes that cannot be believed carry no lever arms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.data.user import User

UNBELIEVED = (Code.QUATERNION_ORDER, Code.ATTITUDE_UNKNOWN)
"""What is found of attitudes by which nobody knows where an antenna was."""
NOT_USED = ", so its antennas are taken to be at its origin"


def at_origin(user: User) -> dict[str, tuple[float, float, float]]:
    """A user's antennas, all of them where its SLAM has the device."""
    return dict.fromkeys(user.antennas, (0.0, 0.0, 0.0))


def without_unbelieved_levers(recording: Recording, found: Sequence[Finding]) -> Recording:
    """The same recording, the antennas of devices whose attitudes are not believed at their origins."""
    who = {finding.user for finding in found if finding.code in UNBELIEVED}
    users = tuple(replace(user, antennas=at_origin(user)) if user.name in who else user for user in recording.users)
    return recording if users == recording.users else replace(recording, users=users)
