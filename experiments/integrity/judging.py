"""One scene, solved at once and played as it would have come, and what is to be said of it."""

from __future__ import annotations

import json
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from experiments.integrity.best import told_apart, well_placed
from experiments.integrity.families import Drawn, drawn
from experiments.integrity.scoring import Episode, Off, Told, episodes, off_by, row_at
from experiments.integrity.trial import Trial, TrueWalk
from synchronizar.data.registration import Registration, State
from synchronizar.data.survey import SURVEY
from synchronizar.data.updates import Update, UserUpdate
from synchronizar.estimation.incremental.replay import replay
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame
from synchronizar.parameters import IncrementalParameters
from synchronizar.threads import one_blas_thread

Task = tuple[str, int]
"""A family and a seed."""


class Verdict(NamedTuple):
    """What is said of one user in the end."""

    user: str
    state: State
    """By the solve of all at once."""
    off: Off | None
    """Of that; None where there is no placement."""
    live: State
    """While people walked, at last."""
    well: bool | None
    """Whether maximum likelihood places it; None where that is not asked."""
    alone: bool = True
    """Whether it knows of no other placement, and of the heading, as far as that is asked."""


class Judged(NamedTuple):
    """A scene that is done."""

    family: str
    seed: int
    kinds: tuple[str, ...]
    version: str
    """Of the estimator and the study."""
    cpu: float
    """s."""
    verdicts: list[Verdict]
    """On all users but the reference."""
    episodes: list[Episode]
    crashed: str = ""
    """What was raised, where something was."""


@one_blas_thread()
def judge(task: Task, version: str = "") -> Judged:
    """One scene; an exception is a result like any other."""
    began = process_time()
    family, seed = task
    scene = drawn(family, seed)
    try:
        verdicts, found = judged(scene)
        crashed = ""
    except Exception as fault:  # whatever it is, the study goes on and tells
        verdicts, found, crashed = [], [], f"{type(fault).__name__}: {fault}"
    return Judged(family, seed, scene.kinds, version, process_time() - began, verdicts, found, crashed)


def judged(scene: Drawn) -> tuple[list[Verdict], list[Episode]]:
    """The verdict on each user but the reference, and the episodes."""
    trial = scene.trial
    truth, recording = trial.truth(), trial.recording
    registration = register(recording)
    reference = str(registration.reference)
    well, alone = well_placed(trial, reference), told_apart(trial, reference)
    played = replay(recording)
    live, whose = played.updates[-1].users, str(played.registration.reference)
    verdicts = [
        Verdict(
            name, user.state, _off(truth, registration, name), live[name].state, well.get(name), alone.get(name, True)
        )
        for name, user in registration.users.items()
        if name != reference
    ]
    found = [
        episode
        for user in recording.users
        if user.name != whose
        for episode in _episodes(trial, truth, played.updates, whose, user.name)
    ]
    return verdicts, found


def _off(truth: dict[str, TrueWalk], registration: Registration, name: str) -> Off | None:
    user, reference = registration.users[name], str(registration.reference)
    if user.common_from_user is None:
        return None
    told = Told(user.state, user.common_from_user, user.covariance)
    of_reference = SURVEYED if reference == SURVEY else registration.users[reference]
    other = Told(State.REGISTERED, of_reference.common_from_user, None)
    ends = [(truth[who], len(truth[who].t) - 1) for who in (name, reference)]
    return off_by(told, other, ends[0], ends[1], user.static)


def _episodes(
    trial: Trial, truth: dict[str, TrueWalk], updates: list[Update], reference: str, name: str
) -> list[Episode]:
    tracks = trial.recording.tracks
    first = float(np.min(trial.recording.ranges.t))
    offs: list[Off | None] = []
    for update in updates:
        user = update.users[name]
        other = SURVEYED if reference == SURVEY else update.users[reference]
        if user.state is not State.REGISTERED or user.common_from_user is None or other.common_from_user is None:
            offs.append(None)
            continue
        if other.state is not State.REGISTERED:  # through whom the user's place is told
            offs.append(None)
            continue
        ends = [(truth[who], row_at(truth[who], tracks.get(who), update.t)) for who in (name, reference)]
        since = row_at(truth[name], tracks.get(name), update.t - JUDGED_WALK)
        told = Told(user.state, user.common_from_user, user.covariance)
        of_reference = Told(other.state, other.common_from_user, None)
        offs.append(off_by(told, of_reference, ends[0], ends[1], user.static, since))
    return episodes(name, [update.t - first for update in updates], offs)


JUDGED_WALK = IncrementalParameters().judged_walk
SURVEYED = UserUpdate(State.REGISTERED, YawFrame(), None, 1.0, True, None)


def line_of(done: Judged) -> str:
    """For the file."""
    fields = done._asdict()
    fields["verdicts"] = [[*v[:2], None if v.off is None else list(v.off), *v[3:]] for v in done.verdicts]
    fields["episodes"] = [[*e[:3], list(e.off), e.off_s] for e in done.episodes]
    return json.dumps(fields) + "\n"


def judged_of(line: str) -> Judged:
    """The same scene again."""
    fields: dict[str, Any] = json.loads(line)
    verdicts = [
        Verdict(user, State(state), None if off is None else Off(*off), State(live), *well)
        for user, state, off, live, *well in fields.pop("verdicts")
    ]
    found = [Episode(user, begin, end, Off(*off), off_s) for user, begin, end, off, off_s in fields.pop("episodes")]
    kinds = tuple(fields.pop("kinds"))
    return Judged(**fields, kinds=kinds, verdicts=verdicts, episodes=found)
