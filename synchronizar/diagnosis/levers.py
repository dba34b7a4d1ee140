"""Antennas whose lever arms are given in a robot's axes while the attitudes are a camera's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.data.user import User
from synchronizar.diagnosis.axes import posture
from synchronizar.diagnosis.pair_fits import Groups, fit_pairs
from synchronizar.parameters import Parameters


def lever_findings(recording: Recording, groups: Groups, parameters: Parameters) -> list[Finding]:
    """Of each device that is carried along its z axis and whose ranges fit better with its arms turned to that."""
    limits = parameters.diagnosis
    meant = {
        u: _in_camera_axes(user)
        for u, user in enumerate(recording.users)
        if not user.static and _longest(user) > limits.lever_least and _carried_along_z(recording, user, parameters)
    }
    affected = np.isin(groups.users, list(meant)).any(axis=1)
    if affected.sum() < limits.fewest_stretches:
        return []
    of = Groups(groups.users[affected], groups.row[affected], groups.there[affected])
    turned = replace(recording, users=tuple(meant.get(u, user) for u, user in enumerate(recording.users)))
    before, after = (fit_pairs(one, of, parameters, free=False).spread for one in (recording, turned))
    share = after / np.maximum(before, 1e-9)
    share, before, after = (x[np.isfinite(share)] for x in (share, before, after))
    if len(share) < limits.fewest_stretches or share.max() > limits.lever_worse:
        return []
    if np.exp(np.log(share).mean()) > limits.lever_left:
        return []
    return [
        Finding(
            Code.OPTICAL_AXES,
            user.name,
            "its antennas are likely given in a robot's axes (x forward, y left, z up) and its attitudes in a camera's "
            f"(x right, y down, z forward): its ranges fit to {np.median(after):.2f} m with the arms turned, otherwise "
            f"to {np.median(before):.2f} m",
            "turn its lever arms in recording.toml: [x, y, z] becomes [-y, -z, x]",
        )
        for user in meant.values()
    ]


def _in_camera_axes(user: User) -> User:
    return replace(user, antennas={name: (-y, -z, x) for name, (x, y, z) in user.antennas.items()})


def _longest(user: User) -> float:
    """m, of its lever arms."""
    return float(np.linalg.norm(user.levers, axis=1).max())


def _carried_along_z(recording: Recording, user: User, parameters: Parameters) -> bool:
    forward = posture(recording.tracks[user.name], "xyzw", user.up, parameters).forward
    return bool(forward[2] > parameters.diagnosis.carried_concentration)
