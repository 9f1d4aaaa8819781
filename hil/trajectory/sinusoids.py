"""Sums of sinusoids about a centre pose, faded in and out."""

import math
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import REAL, helper, record
from drivers.compiled.pointed import Callee, context_of, data_at, integers_at, pointed, reals_at
from drivers.errors import ConfigurationError
from hil.config.reference import SinusoidReference
from hil.config.values import AXES, Pose
from hil.mathematics.trigonometry import sincos
from hil.trajectory.path import SAMPLE, CompiledTrajectory, lift, pose_coordinates, quintic, require_half_turn

WAVES = np.dtype(
    [
        ("axis", "<i8"),
        ("wave", "<i8"),
        ("count", "<i8"),
        ("centre", "<f8", 6),
        ("duration", "<f8"),
        ("ramp", "<f8"),
    ]
)
"""Layout: addresses of the axis (n,), and amplitude (m, rad), Hz, rad (n, 3), of n components; n."""
_TURN = 2.0 * math.pi


@helper
def fade(t: float, duration: float, ramp: float) -> tuple[float, float, float]:
    """Envelope e(t) with de/dt, d2e/dt2: quintic from 0 to 1 over `ramp` s, and back to 0 before the end.

    t: 0 .. duration. Without a ramp e = 1 throughout.
    """
    if t < ramp:
        s, ds, dds = quintic(t / ramp)
        return s, ds / ramp, dds / (ramp * ramp)
    if t > duration - ramp:
        s, ds, dds = quintic((duration - t) / ramp)
        return s, -ds / ramp, dds / (ramp * ramp)
    return 1.0, 0.0, 0.0


@pointed(record(WAVES), REAL, record(SAMPLE))
def evaluate(path: Any, t: float, into: Any) -> int:
    """Fill the sample at t (s) of chi = centre + e(t) sum a sin(2 pi f t + phase), e(t) the envelope."""
    duration = path.duration
    axis, wave = integers_at(path.axis, path.count), reals_at(path.wave, 3 * path.count)
    moving = 0.0 <= t <= duration
    t = min(max(t, 0.0), duration)
    e, de, dde = fade(t, duration, path.ramp)
    chi, dchi, ddchi = np.empty(6), np.zeros(6), np.zeros(6)
    for k in range(6):
        chi[k] = path.centre[k]
    for i in range(path.count):
        a, f, phase = wave[3 * i], wave[3 * i + 1], wave[3 * i + 2]
        turns = f * t
        s, c = sincos(_TURN * (turns - np.floor(turns)) + phase)
        w = _TURN * f
        x, dx, ddx = a * s, a * w * c, -a * w * w * s
        k = axis[i]
        chi[k] += e * x
        if moving:
            dchi[k] += de * x + e * dx
            ddchi[k] += dde * x + 2.0 * de * dx + e * ddx
    lift(chi, dchi, ddchi, into)
    return 0


class SinusoidTrajectory(CompiledTrajectory):
    """chi(t) = centre + e(t) sum of a sin(2 pi f t + phase) on single axes, with the envelope e(t).

    With `ramp_s` 0 the trajectory starts and ends in motion. Raises ConfigurationError if the two ramps
    exceed the duration, or a rotation could exceed half a turn.
    """

    def __init__(self, settings: SinusoidReference, home: Pose, largest: Array | None = None) -> None:
        """Build from the settings. largest: largest deviation (6,) m, rad; default: sum of the amplitudes."""
        if 2.0 * settings.ramp_s > settings.duration_s:
            raise ConfigurationError(
                f"reference.ramp_s: fading in and out takes 2 x {settings.ramp_s:g} s, more than duration_s "
                f"{settings.duration_s:g}; at most {settings.duration_s / 2:g} s fits."
            )
        self.duration_s = settings.duration_s
        centre = pose_coordinates(settings.centre or home)
        axis = np.array([AXES.index(c.axis) for c in settings.components], np.int64)
        self._wave = np.array(
            [
                (
                    np.deg2rad(c.amplitude) if c.axis.endswith("_deg") else c.amplitude,
                    c.frequency_Hz,
                    c.phase_rad,
                )
                for c in settings.components
            ],
            float,
        )
        if largest is None:
            largest = np.zeros(6)
            np.add.at(largest, axis, np.abs(self._wave[:, 0]))
        turn = np.abs(centre[3:]) + largest[3:]
        require_half_turn(float(np.linalg.norm(turn)), "reference: centre and amplitudes")
        path = context_of(
            WAVES,
            axis=axis,
            wave=self._wave,
            count=len(axis),
            centre=centre,
            duration=self.duration_s,
            ramp=settings.ramp_s,
        )
        self.callee = Callee(evaluate.address, data_at(path), (path, axis, self._wave))
