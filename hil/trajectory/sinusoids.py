"""Sums of sinusoids about a centre, faded in and out."""

import math

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import INTEGERS, MATRIX, REAL, VECTOR, direct, helper
from drivers.errors import ConfigurationError
from hil.config.reference import SinusoidReference
from hil.config.values import AXES, Pose
from hil.mathematics.trigonometry import sincos
from hil.trajectory.path import SAMPLE, PoseSample, blank, lift, quintic, require_half_turn, six_words

_TURN = 2.0 * math.pi


@helper
def fade(t: float, duration: float, ramp: float) -> tuple[float, float, float]:
    """Envelope e(t) with de/dt, d2e/dt2: quintic from 0 to 1 over `ramp` s, and back before the end.

    t: 0 .. duration; so without a ramp it is 1 throughout.
    """
    if t < ramp:
        s, ds, dds = quintic(t / ramp)
        return s, ds / ramp, dds / (ramp * ramp)
    if t > duration - ramp:
        s, ds, dds = quintic((duration - t) / ramp)
        return s, -ds / ramp, dds / (ramp * ramp)
    return 1.0, 0.0, 0.0


@direct(REAL, VECTOR, INTEGERS, MATRIX, REAL, REAL, *SAMPLE)
def evaluate(
    t: float, centre: Array, axis: Ints, wave: Array, duration: float, ramp: float,
    p: Array, R: Array, twist: Array, dtwist: Array,
) -> None:  # fmt: skip
    """Fill p, R, twist, dtwist at t (s) of chi = centre + e(t) sum a sin(2 pi f t + phase).

    centre (6,) m, rad; axis (n,) word of each component; wave (n, 3) amplitude (m or rad), Hz, rad.
    """
    moving = 0.0 <= t <= duration
    t = min(max(t, 0.0), duration)
    e, de, dde = fade(t, duration, ramp)
    chi, dchi, ddchi = centre.copy(), np.zeros(6), np.zeros(6)
    for i in range(axis.shape[0]):
        a, f, phase = wave[i, 0], wave[i, 1], wave[i, 2]
        turns = f * t
        s, c = sincos(_TURN * (turns - np.floor(turns)) + phase)
        w = _TURN * f
        x, dx, ddx = a * s, a * w * c, -a * w * w * s
        k = axis[i]
        chi[k] += e * x
        if moving:
            dchi[k] += de * x + e * dx
            ddchi[k] += dde * x + 2.0 * de * dx + e * ddx
    lift(chi, dchi, ddchi, p, R, twist, dtwist)


class SinusoidTrajectory:
    """chi(t) = centre + e(t) sum of a sin(2 pi f t + phase) on single words, e(t) fading in and out.

    With `ramp_s` 0 it starts and ends at speed. Raises ConfigurationError when the two ramps do not fit, or a
    turn could be too large.
    """

    def __init__(self, settings: SinusoidReference, home: Pose, largest: Array | None = None) -> None:
        """Take the largest deviation (6,) m, rad from the centre; by default the sum of the amplitudes."""
        if 2.0 * settings.ramp_s > settings.duration_s:
            raise ConfigurationError(
                f"reference.ramp_s: fading in and out takes 2 x {settings.ramp_s:g} s, more than duration_s "
                f"{settings.duration_s:g}; at most {settings.duration_s / 2:g} s fits."
            )
        self.duration_s = settings.duration_s
        self._ramp = settings.ramp_s
        self._centre = six_words(settings.centre or home)
        self._axis = np.array([AXES.index(c.axis) for c in settings.components], np.int64)
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
            np.add.at(largest, self._axis, np.abs(self._wave[:, 0]))
        turn = np.abs(self._centre[3:]) + largest[3:]
        require_half_turn(float(np.linalg.norm(turn)), "reference: centre and amplitudes")

    def sample(self, t: float) -> PoseSample:
        """Return the sample at t (s); see `Trajectory`."""
        sample = blank()
        evaluate(t, self._centre, self._axis, self._wave, self.duration_s, self._ramp, *sample)
        return sample
