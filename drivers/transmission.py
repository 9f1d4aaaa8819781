"""Transmission from motor to leg: lead screw or pulley, gear, sign, losses, encoder. SI units, leg by leg.

The motor is the shaft whose angle and torque the drive reports. With the lead l in m of leg per turn of the
screw (of a pulley: 2 pi r), the gear N in turns of the motor per turn of the screw, the sign s, the offset q0

    q = q0 + s l n / N            n: turns of the motor
    F0 = s 2 pi N tau / l         without losses; virtual work tau 2 pi dn = F dq

A loss takes its share from the driving side:
F = eta_d F0 while the motor drives the leg (F dq > 0), and F = F0 / eta_b while the leg drives the motor (F
dq < 0). At rest friction can act either way, and F0 lies in between. Up to `full_loss_m_s` the loss grows
with the rate, so that no force jumps when a leg reverses:

    w = sign(F0) min(max(dq / full_loss_m_s, -1), 1)
    F0 / F = 1 + w (1 / eta_d - 1) where w > 0, else 1 + w (1 - eta_b)
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING

import numpy as np

from drivers.arrays import ZERO6, Array, Rows
from drivers.compiled.compiler import helper
from drivers.signals import LEGS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.config import TransmissionSettings


FIELDS = [
    *((name, "<f8", (LEGS,)) for name in ("offset", "m_per_turn", "N_per_Nm", "driving", "back_driving")),
    ("full_loss_m_s", "<f8"),
]
"""Fields of a kernel's record that `Transmission.fill` fills."""


def _row(values: float | Sequence[float]) -> Array:
    row = np.broadcast_to(np.array(values, float), LEGS).copy()
    row.flags.writeable = False
    return row


def forgotten_length(settings: TransmissionSettings, turns: float | list[float]) -> Array:
    """Leg travel (6,) m, > 0, for a number of motor turns, as an encoder loses it at power-off."""
    return np.abs(Transmission(settings).m_per_turn) * _row(turns)


@helper
def loss_of(force: float, rate: float, driving: float, back_driving: float, full_loss_m_s: float) -> float:
    """F0 / F of one leg: ideal force without losses over the real force; NaN if force or rate is NaN.

    force: F or F0, N, of which only the sign counts; rate: dq, m/s; driving, back_driving: efficiencies.
    """
    share = min(max(rate / full_loss_m_s, -1.0), 1.0)
    # 0 - share, not -share: a NaN keeps its sign, and recorded logs their bits
    w = share if force > 0.0 else 0.0 - share if force < 0.0 else share * force
    return 1.0 + (w * (1.0 / driving - 1.0) if w > 0.0 else w * (1.0 - back_driving))


@helper
def fill_loss(
    force: Array, rate: Array, driving: Array, back_driving: Array, full_loss_m_s: float, loss: Array
) -> None:
    """Fill `loss` (6,) with F0 / F of each leg: ideal force without losses over the real force."""
    for leg in range(LEGS):
        loss[leg] = loss_of(force[leg], rate[leg], driving[leg], back_driving[leg], full_loss_m_s)


class Transmission:
    """Six transmissions between motors and legs; every array is (6,), leg order."""

    def __init__(self, settings: TransmissionSettings) -> None:
        """Read the configured values, read-only; a single value counts for all legs."""
        radius_m, gear = settings.pulley_radius_m or 0.0, _row(settings.gear_ratio)
        self.lead_m = 2.0 * pi * _row(radius_m) if settings.lead_m is None else _row(settings.lead_m)
        """m of leg per turn of the screw or pulley, > 0."""
        self.sign = _row(settings.sign)
        """1 if positive turns of the motor extend the leg, else -1."""
        self.m_per_turn = self.sign * self.lead_m / gear
        """m of leg per turn of the motor, signed: s l / N."""
        self.N_per_Nm = self.sign * (2.0 * pi) * gear / self.lead_m
        """N at the leg per N m of the motor without losses, signed: s 2 pi N / l."""
        self.driving, self.back_driving = _row(settings.efficiency), _row(settings.back_driving_efficiency)
        """eta_d and eta_b, > 0 to 1."""
        self.full_loss_m_s = settings.full_loss_m_s
        """Leg rate above which the whole loss acts, > 0."""
        self.offset_m = _row(settings.offset_m)
        """Leg length at which the drive reads position zero."""
        self.counts = _row(settings.counts_per_turn)
        """Encoder counts per turn of the motor, > 0; for drives that report counts."""

    def fill(self, record: Rows) -> None:
        """Copy offsets and ratios into those fields of a kernel's record that have their names."""
        record["offset"], fields = self.offset_m, set(record.dtype.names or ())
        for name in fields & {"m_per_turn", "N_per_Nm", "driving", "back_driving", "counts", "full_loss_m_s"}:
            record[name] = getattr(self, name)

    # motion

    def length(self, turns: Array) -> Array:
        """Leg lengths (6,) m at motor positions (6,) turns."""
        return self.offset_m + self.m_per_turn * turns

    def lengths_within(self, turns: float) -> tuple[Array, Array]:
        """Shortest and longest leg lengths (6,) m for motor positions within +-`turns` turns."""
        ends = self.length(np.full(LEGS, -turns)), self.length(np.full(LEGS, turns))
        return np.minimum(*ends), np.maximum(*ends)

    def turns(self, length: Array) -> Array:
        """Motor positions (6,) turns at leg lengths (6,) m."""
        return (length - self.offset_m) / self.m_per_turn

    def rate(self, turns_per_s: Array) -> Array:
        """Leg rates (6,) m/s at motor speeds (6,) turns/s."""
        return self.m_per_turn * turns_per_s

    # force

    def torque(self, force: Array, rate: Array = ZERO6) -> Array:
        """Motor torques (6,) N m that give leg forces (6,) N, push positive, at leg rates (6,) m/s."""
        return self._loss(force, rate) * force / self.N_per_Nm

    def force(self, torque: Array, rate: Array = ZERO6) -> Array:
        """Leg forces (6,) N, push positive, of motor torques (6,) N m at leg rates (6,) m/s."""
        lossless = self.N_per_Nm * torque
        return lossless / self._loss(lossless, rate)

    def _loss(self, force: Array, rate: Array) -> Array:
        """F0 / F (6,), from eta_b to 1 / eta_d, 1 at rest; only the sign of `force` counts."""
        loss = np.empty(LEGS)
        fill_loss(force, rate, self.driving, self.back_driving, self.full_loss_m_s, loss)
        return loss
