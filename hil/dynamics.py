"""The controller's model of the robot; the code is in `hil.robot.dynamics`."""

from hil.robot.dynamics import Model

__all__ = ["Model"]
