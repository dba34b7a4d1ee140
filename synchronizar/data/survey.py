"""Radios whose places were surveyed: they give the common frame, in which every device that moves is free.

The problem then has one user more, the survey's own origin: it stands still in the middle of the surveyed radios, is
the reference, and has no ranges. Places are about it, so that they are small numbers wherever the survey's origin is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from synchronizar.data.recording import Recording
from synchronizar.data.user import User

SURVEY = "survey"
"""What the reference is called where the common frame is a survey's."""
_AFTER_ALL = "\U0010ffff"
"""A name that sorts after every user's."""


def survey_origin(users: Iterable[User]) -> User | None:
    """The origin of the survey that some users' positions are of; None where nobody was surveyed."""
    places = [user.position for user in users if user.position is not None]
    if not places:
        return None
    x, y, z = np.mean(places, axis=0).tolist()
    return User(_AFTER_ALL, static=True, position=(x, y, z), position_sigma=0.0)


def with_survey_origin(recording: Recording) -> Recording:
    """The recording with its survey's origin as the last user; as it is where nobody was surveyed."""
    origin = survey_origin(recording.users)
    return recording if origin is None else replace(recording, users=(*recording.users, origin))
