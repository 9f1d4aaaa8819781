"""Small motions about a pose that excite the loop, to identify its delay or its linearised axes.

Each is a section `reference` of the configuration, so an ordinary run performs it.
"""

from math import ceil, pi
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Ints
from drivers.errors import IdentificationError
from hil.config.axis_model import AxisSpace
from hil.config.reference import Sinusoid, SinusoidReference
from hil.config.values import AXES, Pose
from hil.lab.identify.estimators.response import FEWEST_BLOCKS
from hil.mathematics.rotations import rotation_from_vector, rotation_vector_rate
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.trajectory.multisine import schroeder

DELAY_LINES, DELAY_LOWEST_Hz, DELAY_HIGHEST = 6, 10.0, 0.3
"""Lines per axis, each line on one axis only; band: lowest in Hz, highest as a share of the loop's rate."""
DELAY_SLOW_Hz = 150.0
"""Below this rate the band shrinks in proportion, since it has no room for whole frequencies."""
CARRIER_Hz, CARRIER_m = 1.0, 3e-3
"""Slow motion of all legs together: it keeps them sliding despite Coulomb friction."""
DELAY_RAMP_S = 0.5
LINES, LOWEST_Hz, HIGHEST = 12, 1.0, 0.1
"""Lines per axis and band for identifying the axes."""
PERIOD_S = 2.0
"""Shortest period; a slow loop needs a longer one for all lines."""
PERIODS = 5
RAMP_S, SETTLING_S = 1.0, 0.5
SLIDING = 1.5
"""Speed of the slow leg motion, as a multiple of the lines' largest leg speed, so no leg reverses."""
SLOWEST_m_s = 4e-3
"""Below this speed, legs with friction stick and slip."""
DRIFT_Hz = 5e-4
"""Frequency of a sinusoid of which only the straight part is used, as a drift."""


class _Directions(NamedTuple):
    """Leg forces, leg rates and pose changes for a unit motion of each axis at a pose."""

    forces: Array
    """(6, 6) N, leg forces for 1 m/s^2 or 1 rad/s^2 of each axis."""
    leg_rates: Array
    """(6, 6) m/s, leg rates for 1 m/s or 1 rad/s of each axis."""
    words: Array
    """(6, 6) m, deg, change of the pose for 1 m or 1 rad of each axis."""
    together: Array
    """(6,) m, deg, change of the pose for 1 m of all legs."""


def delay_excitation(
    model: Model, pose: Pose, rate_Hz: float, force_N: float, duration_s: float
) -> SinusoidReference:
    """Sinusoids about `pose` that excite the loop to identify its delay.

    The largest leg force is `force_N` on top of the static force. All lines of an axis have equal
    accelerations, so each amplitude falls with the square of the frequency. The axes load the legs equally.
    In addition, all legs extend and retract slowly by 3 mm. duration_s includes fading in and out.
    """
    slower = min(1.0, rate_Hz / DELAY_SLOW_Hz)
    lines = _spread(6 * DELAY_LINES, DELAY_LOWEST_Hz, DELAY_HIGHEST * rate_Hz / slower)
    frequency = np.asarray(slower * lines, float)
    at = _directions(model, pose, "pose")
    components, _ = _multisine(at, frequency, 1.0 / slower, force_N, equal=2)
    components = _sinusoids(at.together * CARRIER_m, CARRIER_Hz, 0.0) + components
    ramp_s = min(DELAY_RAMP_S, duration_s / 4.0)
    return SinusoidReference(
        type="sinusoids", centre=pose, components=components, ramp_s=ramp_s, duration_s=duration_s
    )


def axis_excitation(
    model: Model, pose: Pose, space: AxisSpace, rate_Hz: float, force_N: float, duration_s: float | None
) -> SinusoidReference:
    """Sinusoids about `pose` with 12 lines on each axis, from 1 Hz to a tenth of the rate.

    The lines of an axis have equal speeds: as the frequency grows, accelerations grow and positions, read by
    the encoders, fall. The axes load the legs equally; the largest leg force is `force_N` on top of the
    static force. Lines are multiples of 1/period and neighbours belong to different axes, so whole
    periods separate the axes. A leg moves alone when the pose moves along a column of J^-1.

    In addition, all legs extend at one speed, faster than the lines ever move them back. So Coulomb friction
    is constant. Each period also meets the encoder steps at other places, so their rounding acts as noise,
    which averages out and shows in the standard deviations. duration_s includes fading; default: five
    periods.

    Raises IdentificationError: shorter than four periods.
    """
    n = 6 * LINES
    period_s = max(PERIOD_S, float(ceil(2.5 * n / (HIGHEST * rate_Hz))))
    settled = 2.0 * RAMP_S + SETTLING_S
    periods = PERIODS if duration_s is None else int((duration_s - settled) / period_s + 1e-9)
    if periods < FEWEST_BLOCKS:
        raise IdentificationError(
            f"--duration {duration_s:g}: room for {periods} whole periods of {period_s:g} s, allowed: at "
            f"least {FEWEST_BLOCKS}, {settled + FEWEST_BLOCKS * period_s:g} s with fading"
        )
    frequency = _spread(n, round(LOWEST_Hz * period_s), int(HIGHEST * rate_Hz * period_s)) / period_s
    at = _directions(model, pose, space)
    components, fastest = _multisine(at, frequency, period_s, force_N, equal=1)
    duration = settled + periods * period_s
    drift = max(SLIDING * fastest, SLOWEST_m_s) / (2.0 * pi * DRIFT_Hz)
    components = _sinusoids(at.together * drift, DRIFT_Hz, -pi * DRIFT_Hz * duration) + components
    return SinusoidReference(
        type="sinusoids", centre=pose, components=components, ramp_s=RAMP_S, duration_s=duration
    )


def _multisine(
    at: _Directions, frequency: Array, period_s: float, force_N: float, *, equal: int
) -> tuple[list[Sinusoid], float]:
    """Sinusoids at frequencies (n,) Hz, neighbours on different axes; and the largest leg rate, m/s.

    The axes load the legs equally, by force_N at most. The lines of an axis are equal in the derivative of
    order `equal`: 1 rates, 2 accelerations.
    """
    n, w = len(frequency), 2.0 * pi * frequency
    phases, axis = np.array(schroeder(n, 0)), np.arange(n) % 6
    turns = np.outer(w, np.arange(0.0, period_s, 0.1 / frequency[-1])) + phases[:, None]
    amplitude = 1.0 / np.abs(at.forces).max(axis=0)[axis] / w**equal

    def largest(of_axes: Array, waves: Array) -> float:
        sums = np.array([waves[axis == j].sum(axis=0) for j in range(6)])
        return float(np.abs(of_axes @ sums).max())

    amplitude *= force_N / largest(at.forces, (amplitude * w**2)[:, None] * np.sin(turns))
    lines = zip(at.words[:, axis].T * amplitude[:, None], frequency.tolist(), phases, strict=True)
    components = [each for line in lines for each in _sinusoids(*line)]
    return components, largest(at.leg_rates, (amplitude * w)[:, None] * np.cos(turns))


def _sinusoids(moved: Array, frequency_Hz: float, phase: float) -> list[Sinusoid]:
    """Components of one line; moved (6,): amplitudes m, deg of the pose; phase: rad."""
    return [
        Sinusoid(
            axis=axis,
            amplitude=float(f"{amplitude:.6g}"),
            frequency_Hz=frequency_Hz,
            phase_rad=float(f"{phase % (2.0 * pi):.6f}"),
        )
        for axis, amplitude in zip(AXES, moved, strict=True)
        if abs(amplitude) > 1e-6 * np.abs(moved).max()
    ]


def _spread(n: int, lowest: float, highest: float) -> Ints:
    """Distinct integers (n,), evenly spread on a logarithmic scale where possible."""
    found = np.geomspace(lowest, highest, n).round().astype(np.int64)
    for k in range(1, n):
        found[k] = max(found[k], found[k - 1] + 1)
    return found


def _directions(model: Model, pose: Pose, space: AxisSpace) -> _Directions:
    p = np.array(pose.position_m, float)
    r = np.deg2rad(np.array(pose.rotation_vector_deg, float))
    R = rotation_from_vector(r)
    J = jacobian(model.platform, p, R)
    inverse = np.asarray(np.linalg.inv(J), np.float64)
    twist = inverse if space == "joint" else np.eye(6)

    def words(twist: Array) -> Array:
        return np.concatenate([twist[:3], np.rad2deg(rotation_vector_rate(r, twist[3:].copy()))])

    return _Directions(
        inverse.T @ model.mass_matrix(p, R) @ twist,
        J @ twist,
        np.array([words(column) for column in twist.T]).T,
        words(inverse.sum(axis=1)),
    )
