"""A robot that takes part: it is somebody's mirror image, or comes when called, and keeps away from everybody."""

from synchronizar.apps.robot.game import Robots

__all__ = ["Robots"]
