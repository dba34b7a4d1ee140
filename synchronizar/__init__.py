"""Devices that each run their own SLAM, put into one frame from nothing but the distances between them.

import synchronizar as sz

recording = sz.Recording.load("walk/")
registration = sz.register(recording)
registration.users["bob"].common_from_user @ points
"""

from typing import Any

import lazy_loader

# What there is, and where it lives, stands in __init__.pyi; each name is imported when it is first asked for, because
# gtsam alone takes longer to load than most commands need.
_imported, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("synchronizar")
    return _imported(name)
