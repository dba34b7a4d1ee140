"""Entries of a survey that the ranges contradict."""

from __future__ import annotations

import numpy as np

from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration, State
from synchronizar.parameters import Parameters


def survey_findings(recording: Recording, registration: Registration, parameters: Parameters) -> list[Finding]:
    """Of each surveyed radio that a solution has somewhere else than its entry says."""
    found = []
    for user in recording.users:
        if user.position is None:
            continue
        one = registration.users[user.name]
        if one.state is not State.UNOBSERVABLE or one.common_from_user is None:
            continue
        there = one.common_from_user.translation
        apart = float(np.linalg.norm(there - user.position))
        if apart < parameters.integrity.survey_contradicted:
            continue
        said, at = (", ".join(f"{x:.2f}" for x in place) for place in (user.position, there.tolist()))
        found.append(
            Finding(
                Code.SURVEY,
                user.name,
                f"its ranges say that it is at [{at}], {apart:.1f} m from its position [{said}]",
                f"survey it again, or correct `position` under [users.{user.name}] in recording.toml",
            )
        )
    return found
