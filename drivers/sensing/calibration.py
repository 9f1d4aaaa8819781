"""Sections `calibration` of the sensors: what `hil identify sensors` prints, taken off each sample."""

from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from drivers.arrays import Array
from drivers.config import Above0
from drivers.rotations import turn
from drivers.section import Section
from drivers.sensing.layout import QUANTITIES

Three = tuple[float, float, float]
Legs = tuple[float, float, float, float, float, float]
Scales = tuple[Above0, Above0, Above0, Above0, Above0, Above0]
_ZERO = (0.0, 0.0, 0.0)
_UNIT = np.eye(3)


class Correction(NamedTuple):
    """values = mix reading + shift; then, if `placed`, what SLOT says of frame, target and lever."""

    mix: Array = np.eye(QUANTITIES)
    shift: Array = np.zeros(QUANTITIES)
    placed: bool = False
    frame: Array = _UNIT
    target: Array = _UNIT
    lever: Array = np.zeros(3)


def _less(*offset: float, mix: Array | None = None) -> Correction:
    """Correction mix (reading - offset)."""
    mix = np.eye(QUANTITIES) if mix is None else mix
    return Correction(mix, -mix @ np.array((*offset, *(0.0,) * (QUANTITIES - len(offset)))))


def _rotation(degrees: Three) -> Array:
    return turn(np.deg2rad(np.array(degrees)), np.eye(3))


class Calibration(Section):
    """Errors of a sensor, found by `hil identify sensors`; without them its samples are used as they are."""

    time_offset_ms: Annotated[float, Field(ge=-60, le=60)] = 0.0
    """By how much the stated instant of a sample is later than the sample."""

    def correction(self, _leg: int) -> Correction:
        """From reading to values, SI."""
        return Correction()


class TrackerCalibration(Calibration):
    """Frame and target of a tracker: it reports y = T + B (p + R a) and Y = B R C for the pose p, R."""

    frame_position_m: Three = _ZERO
    """T: origin of the base frame in the tracker's frame."""
    frame_rotation_deg: Three = _ZERO
    """B: rotation vector from the base frame to the tracker's frame."""
    lever_arm_m: Three = _ZERO
    """a: place of the target in the platform's frame."""
    target_rotation_deg: Three = _ZERO
    """C: rotation vector from the target's frame to the platform's."""

    def correction(self, _leg: int) -> Correction:
        """Position B^T (y - T) - R a, rotation R = B^T Y C^T."""
        B, C = _rotation(self.frame_rotation_deg), _rotation(self.target_rotation_deg)
        mix = np.eye(QUANTITIES)
        mix[:3, :3] = B.T
        placed = any((*self.frame_rotation_deg, *self.lever_arm_m, *self.target_rotation_deg))
        of = _less(*self.frame_position_m, mix=mix)
        return Correction(of.mix, of.shift, placed, B.T, C.T, np.array(self.lever_arm_m))


class ImuCalibration(Calibration):
    """Mounting and offsets of an IMU. The device itself reduces to the platform's origin."""

    frame_rotation_deg: Three = _ZERO
    """Rotation vector from the sensor's frame to the platform's."""
    angular_rate_bias_rad_s: Three = _ZERO
    specific_force_bias_m_s2: Three = _ZERO

    def correction(self, _leg: int) -> Correction:
        """F (reading - bias)."""
        mix = np.asarray(np.kron(np.eye(2), _rotation(self.frame_rotation_deg)), np.float64)
        return _less(*self.angular_rate_bias_rad_s, *self.specific_force_bias_m_s2, mix=mix)


class InclinationCalibration(Calibration):
    """Offsets of an inclinometer."""

    offset_deg: tuple[float, float] = (0.0, 0.0)
    """Of roll and pitch."""

    def correction(self, _leg: int) -> Correction:
        """Reading less the offsets."""
        return _less(*np.deg2rad(self.offset_deg))


class LengthCalibration(Calibration):
    """Scale and offset of the second encoders."""

    scale: Scales = (1.0,) * 6
    """Reading over true value, of each leg."""
    offset_m: Legs = (0.0,) * 6
    """Reading at length 0, of each leg."""

    def correction(self, leg: int) -> Correction:
        """(reading - offset) / scale."""
        return _less(self.offset_m[leg], mix=np.eye(QUANTITIES) / self.scale[leg])


class ForceCalibration(Calibration):
    """Scale and offset of the load cells."""

    scale: Scales = (1.0,) * 6
    """Reading over true value, of each leg."""
    offset_N: Legs = (0.0,) * 6
    """Reading at force 0, of each leg."""

    def correction(self, leg: int) -> Correction:
        """(reading - offset) / scale."""
        return _less(self.offset_N[leg], mix=np.eye(QUANTITIES) / self.scale[leg])
