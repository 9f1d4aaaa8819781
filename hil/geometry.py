"""The robot as numbers; the code is in `hil.robot.geometry`."""

from hil.robot.geometry import Body, GeometryError, LegBody, Platform

__all__ = ["Body", "GeometryError", "LegBody", "Platform"]
