"""Whether a device's attitudes can be believed, by its poses so far."""

from __future__ import annotations

from synchronizar.data.findings import Code
from synchronizar.data.track import Track
from synchronizar.diagnosis.axes import posture, sign_of
from synchronizar.diagnosis.poses import attitude_is_the_same
from synchronizar.geometry import Up
from synchronizar.parameters import Parameters

_Z = 2


def why_not_believed(track: Track, up: Up, parameters: Parameters) -> str | None:
    """Why nobody knows by these attitudes where an antenna was; None where nothing plain speaks against them."""
    if attitude_is_the_same(track, parameters):
        return "its attitude is the same throughout while it moves, so it was likely never measured"
    sign = sign_of(track, up, parameters)
    if sign is not None and sign.code is Code.QUATERNION_ORDER:
        return "its quaternions are likely in the order w x y z"
    return None


def is_upright(track: Track, up: Up, parameters: Parameters) -> bool:
    """Whether a device has turned about the vertical enough for its attitudes to tell that they are read rightly."""
    enough = len(track) >= parameters.diagnosis.axes_fewest_poses
    return enough and posture(track, "xyzw", up, parameters).vertical == _Z
