"""Geometry and rigid bodies of the robot; the code is in `hil.robot.geometry`."""

from hil.robot.geometry import Body, GeometryError, LegBody, Platform

__all__ = ["Body", "GeometryError", "LegBody", "Platform"]
