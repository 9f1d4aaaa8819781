"""Multisines for identification: many spectral lines on each axis, with phases for a low peak.

Random phases are drawn once, from the configured seed.
"""

import math
from random import Random

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import INTEGERS, VECTOR, kernel
from drivers.errors import ConfigurationError
from hil.config.reference import MultisineAxis, MultisineReference, Sinusoid, SinusoidReference
from hil.config.values import AXES, Pose
from hil.mathematics.trigonometry import sincos
from hil.trajectory.sinusoids import SinusoidTrajectory

POINTS_PER_CYCLE = 64
"""Search points per cycle of the highest line; the peak between two points is at most 0.12 % higher."""
SEARCHED = 2_000_000
"""Limit of lines times highest multiple of 1/period_s: the search for the peak then takes some seconds."""
_TURN = 2.0 * math.pi


def multisine_trajectory(settings: MultisineReference, home: Pose) -> SinusoidTrajectory:
    """Sum of sinusoids about a pose, faded in and out; the first whole period begins at `ramp_s`.

    Raises ConfigurationError when a band has too few frequencies for its lines.
    """
    taken: set[int] = set()
    components: list[Sinusoid] = []
    largest = np.zeros(6)
    for n, axis in enumerate(settings.axes):
        harmonics = pick_lines(axis, settings.period_s, taken, f"reference.axes[{n}]")
        taken.update(harmonics)
        phases = PHASES[axis.phases](len(harmonics), axis.seed)
        largest[AXES.index(axis.axis)] += (
            math.radians(axis.amplitude) if axis.axis.endswith("_deg") else axis.amplitude
        )
        line = axis.amplitude / peak(np.array(harmonics, np.int64), np.array(phases, float))
        for harmonic, phase in zip(harmonics, phases, strict=True):
            f = harmonic / settings.period_s
            # The phases apply to the start of the period, which begins after the ramp.
            late = harmonic * (settings.ramp_s / settings.period_s)
            components.append(
                Sinusoid(
                    axis=axis.axis,
                    amplitude=line,
                    frequency_Hz=f,
                    phase_rad=phase - _TURN * (late - math.floor(late)),
                )
            )
    return SinusoidTrajectory(
        SinusoidReference(
            type="sinusoids",
            centre=settings.centre,
            components=components,
            ramp_s=settings.ramp_s,
            duration_s=2.0 * settings.ramp_s + settings.periods * settings.period_s,
        ),
        home,
        largest,
    )


def pick_lines(axis: MultisineAxis, period_s: float, taken: set[int], where: str) -> list[int]:
    """Harmonics of 1/period_s for an axis, spread evenly over its band, none of them in `taken`.

    Separate lines distinguish the responses to several axes in one run. Raises ConfigurationError.
    """
    low, high = axis.band_Hz
    if high * period_s * axis.lines > SEARCHED:
        raise ConfigurationError(
            f"{where}.band_Hz: {axis.lines} lines up to {high * period_s:.3g} times 1/period_s take too long "
            f"to sum, allowed: up to {SEARCHED / axis.lines / period_s:g} Hz. Shorten period_s, "
            "lower the band, or take fewer lines."
        )
    first, last = math.ceil(low * period_s - 1e-9), math.floor(high * period_s + 1e-9)
    free = [k for k in range(first, last + 1) if k not in taken]
    if low > high or len(free) < axis.lines:
        used = sum(k in taken for k in range(first, last + 1))
        raise ConfigurationError(
            f"{where}.lines: {axis.lines} lines do not fit into {low:g} to {high:g} Hz, allowed: at most "
            f"{len(free)}, the multiples of 1/period_s = {1 / period_s:g} Hz there"
            + (f" minus {used} of other axes" if used else "")
            + ". Lengthen period_s or widen band_Hz."
        )
    if axis.lines == 1:
        return [free[0]]
    return [free[round(i * (len(free) - 1) / (axis.lines - 1))] for i in range(axis.lines)]


def schroeder(lines: int, seed: int) -> list[float]:  # noqa: ARG001
    """Phases in rad that keep the peak of equal lines low: -pi k (k - 1)/n, k = 1 .. n.

    M. R. Schroeder, Synthesis of low-peak-factor signals, IEEE Trans. Inf. Theory 16(1), 1970.
    """
    return [-math.pi * ((k * (k - 1)) % (2 * lines)) / lines for k in range(1, lines + 1)]


def seeded(lines: int, seed: int) -> list[float]:
    """Phases in rad, uniform over a turn; one seed gives equal phases on every machine."""
    draw = Random(seed).random  # noqa: S311 - no secret
    return [_TURN * draw() for _ in range(lines)]


PHASES = {"schroeder": schroeder, "random": seeded}


@kernel(INTEGERS, VECTOR)
def peak(harmonics: Ints, phases: Array) -> float:
    """Upper bound of |sum of sin(k w t + phase)| over a period, at most 0.12 % above the true maximum.

    A sum of degree n is at most its largest value at N points of a period divided by cos(pi n/N).
    """
    n = np.max(harmonics)
    points = POINTS_PER_CYCLE * n
    largest = 0.0
    for i in range(points):
        total = 0.0
        for j in range(harmonics.shape[0]):
            total += sincos(_TURN * (harmonics[j] * i % points) / points + phases[j])[0]
        largest = max(largest, abs(total))
    return largest / sincos(math.pi / POINTS_PER_CYCLE)[1]
