"""Base class of the project's exceptions, and their hierarchy.

::

    HilError
    ├── ConfigurationError      configuration file or a value in it
    ├── BusError                the bus cannot be opened, is down or overloaded
    ├── ProtocolError           a frame or a signal that the protocol cannot carry
    ├── ModelError              geometry, kinematics, dynamics, linear systems
    │   ├── GeometryError       an impossible platform (hil.robot.geometry)
    │   ├── KinematicsError     an invalid pose, or one that cannot be found (hil.robot.kinematics)
    │   ├── WorkspaceError      home or a requested pose outside the limits (hil.study.workspace.limits)
    │   ├── CalibrationError    measurements that cannot calibrate
    │   ├── IdentificationError a log without the data that is needed
    │   └── SynthesisError      a design that no controller fulfils
    ├── PlantError              plant, FMU, FMU hosting
    ├── LogError                log file: not MCAP, truncated, of another version
    │   └── RecorderEndedError  the recorder has ended before its simulation (hil.record.recording)
    ├── RunError                the run itself: no drives, latched fault, another daemon
    ├── RefusedError            no consent to a step of a bring-up, or its end (hil.lab.bringup.context)
    └── StoppedError            a measured value ended a step for safety (hil.lab.bringup.context)

Errors with attributes of their own are defined where they are raised, the others here. A message says what
happened, where, what was allowed and what to do.
"""

import sys


class HilError(Exception):
    """Base of all errors that a user can cause or fix."""


class ConfigurationError(HilError):
    """A configuration that cannot be used; `problems` has all errors, one line each."""

    SHOWN = 100
    """Most lines in the message; a file of another kind has an error in each line."""

    def __init__(self, *problems: str) -> None:
        more = len(problems) - self.SHOWN
        super().__init__("\n".join((*problems[: self.SHOWN], *([f"and {more} more"] if more > 0 else []))))
        self.problems = problems


class BusError(HilError):
    """The bus cannot be opened, is down, or cannot carry the configured traffic."""


class ProtocolError(HilError):
    """A frame or signal value outside the range that the drive protocol can carry."""


class ModelError(HilError):
    """Invalid geometry, kinematics or dynamics."""


class CalibrationError(ModelError):
    """Measurements from which no calibration is possible: too few, not finite, of another robot or unit."""


class IdentificationError(ModelError):
    """A log without the data that an identification of parameters needs, or with too little of it."""


class SynthesisError(ModelError):
    """A controller design whose requirements no controller meets, or an ill-posed design problem."""


class PlantError(HilError):
    """The plant or the FMU behind it cannot be used."""


class LogError(HilError):
    """A log file that cannot be read or written."""


class RunError(HilError):
    """The run ended or could not start: no drives, latched fault, another daemon."""


def require_linux(what: str) -> None:
    """Raise RunError on a system without the calls that real time, buses and child processes need."""
    if sys.platform != "linux":
        raise RunError(
            f"{what} needs Linux, this is {sys.platform}; `hil new`, `check`, `sim`, `replay`, `report`, "
            "`plot` and `export` do not, nor `hil.Log` and `hil.sim` in Python"
        )
