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
    from synchronizar.data.ranges import Ranges
    from synchronizar.data.recording import Recording
    from synchronizar.data.registration import Registration, State
    from synchronizar.data.track import Track
    from synchronizar.data.user import User
    from synchronizar.errors import InputError
    from synchronizar.estimation.incremental.estimator import Estimator
    from synchronizar.estimation.register import register
    from synchronizar.geometry import YawFrame
    from synchronizar.graph.range_factors import (
        DeviceBlockFactor,
        DeviceKeys,
        FixedUser,
        RangeBlockFactor,
        RangeFactor,
        UserKeys,
    )
    from synchronizar.parameters import Model

_HOMES = {
    "DeviceBlockFactor": "graph.range_factors",
    "DeviceKeys": "graph.range_factors",
    "Estimator": "estimation.incremental.estimator",
    "FixedUser": "graph.range_factors",
    "InputError": "errors",
    "Model": "parameters",
    "RangeBlockFactor": "graph.range_factors",
    "RangeFactor": "graph.range_factors",
    "Ranges": "data.ranges",
    "Recording": "data.recording",
    "Registration": "data.registration",
    "State": "data.registration",
    "Track": "data.track",
    "User": "data.user",
    "UserKeys": "graph.range_factors",
    "YawFrame": "geometry",
    "register": "estimation.register",
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
