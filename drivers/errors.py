"""The root of the one error tree.

::

    HilError
    ├── ConfigurationError      configuration file or a value in it
    ├── BusError                the bus cannot be opened, is down or overloaded
    ├── ProtocolError           a frame or a signal that the protocol cannot carry
    ├── ModelError              geometry, kinematics, dynamics (hil.robot.geometry, hil.robot.kinematics)
    │   ├── GeometryError
    │   ├── KinematicsError
    │   ├── CalibrationError    measured pairs that cannot calibrate (hil.robot.calibration)
    │   ├── IdentificationError a log that does not hold what is looked for (hil.identify)
    │   └── SynthesisError      a design that no controller fulfils (hil.synthesis.errors)
    ├── PlantError              plant, FMU, FMU hosting (plant_fmu)
    ├── LogError                log file: not MCAP, truncated, of another version
    └── RunError                the run itself: no drives, latched fault, another daemon

Every exception carries values as attributes where there are any; its message says
what happened, where, what was allowed and what to do about it.
"""

from __future__ import annotations


class HilError(Exception):
    """Base of all errors that a user can cause or mend."""


class ConfigurationError(HilError):
    """A configuration that cannot be used; `problems` holds all that is wrong, one line each."""

    def __init__(self, *problems: str) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


class BusError(HilError):
    """The bus cannot be opened, is down, or cannot carry the configured traffic."""


class ProtocolError(HilError):
    """A frame or signal value outside what the protocol can carry."""


class ModelError(HilError):
    """Geometry, kinematics or dynamics that have no meaning."""


class PlantError(HilError):
    """The plant or the FMU behind it cannot be used."""


class LogError(HilError):
    """A log file that cannot be read or written."""


class RunError(HilError):
    """The run ended or could not start: no drives, latched fault, another daemon."""
