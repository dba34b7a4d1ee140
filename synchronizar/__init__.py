"""Devices that each run their own SLAM, put into one frame from nothing but the distances between them.

import synchronizar as sz

recording = sz.Recording.load("walk/")
registration = sz.register(recording)
registration.users["bob"].common_from_user @ points
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from synchronizar.errors import InputError
    from synchronizar.factors import (
        DeviceBlockFactor,
        DeviceKeys,
        FixedUser,
        RangeBlockFactor,
        RangeFactor,
        UserKeys,
    )
    from synchronizar.geometry import YawFrame
    from synchronizar.incremental import Estimator
    from synchronizar.model import Model
    from synchronizar.pipeline import register
    from synchronizar.ranges import Ranges
    from synchronizar.recording import Recording
    from synchronizar.registration import Registration, State
    from synchronizar.track import Track
    from synchronizar.user import User

_HOMES = {
    "DeviceBlockFactor": "factors",
    "DeviceKeys": "factors",
    "Estimator": "incremental",
    "FixedUser": "factors",
    "InputError": "errors",
    "Model": "model",
    "RangeBlockFactor": "factors",
    "RangeFactor": "factors",
    "Ranges": "ranges",
    "Recording": "recording",
    "Registration": "registration",
    "State": "registration",
    "Track": "track",
    "User": "user",
    "UserKeys": "factors",
    "YawFrame": "geometry",
    "register": "pipeline",
}

__all__ = [
    "DeviceBlockFactor",
    "DeviceKeys",
    "Estimator",
    "FixedUser",
    "InputError",
    "Model",
    "RangeBlockFactor",
    "RangeFactor",
    "Ranges",
    "Recording",
    "Registration",
    "State",
    "Track",
    "User",
    "UserKeys",
    "YawFrame",
    "register",
]


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is asked for: gtsam alone takes longer to load than most commands need."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
