"""The main job: a recording in, everybody's frame out."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from synchronizar.data.findings import Code
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration
from synchronizar.data.survey import with_survey_origin
from synchronizar.diagnosis import findings_of
from synchronizar.diagnosis.attitudes import without_unbelieved_levers
from synchronizar.diagnosis.radios import without_swapped_radios
from synchronizar.diagnosis.reasons import with_reasons
from synchronizar.diagnosis.solution import findings_of_solution
from synchronizar.diagnosis.stamps import without_ranges_of_unknown_time
from synchronizar.diagnosis.survey import survey_findings
from synchronizar.errors import InputError
from synchronizar.estimation.full import register_full
from synchronizar.estimation.rigid import register_rigid
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.suspect_poses import without_suspect_poses
from synchronizar.progress import Progress, unheard
from synchronizar.threads import one_blas_thread

_NAMED = 12  # users, in a message


@one_blas_thread()
def register(
    recording: Recording,
    reference: str | None = None,
    model: Literal["full", "rigid"] = "full",
    parameters: Parameters | None = None,
    progress: Progress | None = None,
) -> Registration:
    """Where every user's frame lies in the reference's, how sure that is, and which ranges it rests on.

    Where radios were surveyed the common frame is the survey's, and there is no `reference` to choose.
    `model` full: SLAM may drift, jump, have a wrong scale and clock, radios a bias. rigid: SLAM is trusted, one frame
    per user and nothing else. `progress` hears what share of the work is done. Raises InputError where `reference` is
    nobody or a static radio, or where nobody can be the reference. What cannot be answered is told as a state.
    """
    if not isinstance(recording, Recording):
        raise ValueError(
            f"recording: must be a Recording (Recording.load reads a folder), not {type(recording).__name__}"
        )
    if model not in ("full", "rigid"):
        raise ValueError(f'model: must be "full" or "rigid", not {model!r}')
    parameters = parameters or Parameters()
    measured = with_survey_origin(recording)
    ref = reference_of(measured, reference, parameters)
    found = findings_of(recording, parameters)
    if any(finding.code is Code.TIME_UNIT and finding.user == measured.users[ref].name for finding in found):
        model = "rigid"  # drift grows with seconds, and nobody else can be tied to the reference
    solve = register_full if model == "full" else register_rigid
    used = without_suspect_poses(without_ranges_of_unknown_time(measured, found), parameters)
    used = without_unbelieved_levers(without_swapped_radios(used, found), found)
    registration = solve(used, ref, parameters, progress or unheard)
    found += findings_of_solution(without_suspect_poses(recording, parameters), registration, found, parameters)
    found += survey_findings(recording, registration, parameters)
    return with_reasons(_with_used_poses(registration, recording, used), found)


def _with_used_poses(registration: Registration, recording: Recording, used: Recording) -> Registration:
    """The same, its tracks being those of the poses that were used, also where SLAM is trusted."""
    fewer = {name: track for name, track in used.tracks.items() if len(track) < len(recording.tracks[name])}
    users, own = dict(registration.users), registration.tracks(used)
    for name in fewer:
        if name in own:
            users[name] = replace(users[name], common_track=own[name])
    return replace(registration, users=users)


def reference_of(recording: Recording, name: str | None, parameters: Parameters) -> int:
    """Whose frame the common one is: the survey's origin, else a user of that name, or the first by name that moves.

    InputError if nobody.
    """
    if recording.users and recording.users[-1].is_survey_origin:
        if name is not None:
            raise InputError("--reference", "radios were surveyed: the common frame is the survey's")
        return len(recording.users) - 1
    if name is None:
        moving = [u for u, user in enumerate(recording.users) if not user.static]
        if not moving:
            raise InputError("recording.toml", "every user is a static radio: nobody has a frame to be the common one")
        far = [u for u in moving if recording.tracks[recording.users[u].name].extent() > parameters.priors.least_extent]
        return (far or moving)[0]
    try:
        user = recording.index(name)
    except KeyError:
        names = ", ".join([other.name for other in recording.users if not other.static][:_NAMED])
        raise InputError("--reference", f"there is no user '{name}'; there are {names}") from None
    if recording.users[user].static:
        raise InputError("--reference", f"'{name}' is a static radio: it has no heading for the common frame")
    return user
