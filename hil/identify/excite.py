"""A multisine about a pose that moves each linearised axis at lines of its own.

Rule of the room: see `hil.identify`; gives a `reference` section, so that the run is an ordinary one.
"""

from __future__ import annotations

from math import ceil, pi

import numpy as np
from numpy.typing import NDArray

from hil.config import Pose, Sinusoid, SinusoidReference
from hil.config.axis_model import AxisSpace
from hil.dynamics import Model
from hil.identify.errors import IdentificationError
from hil.identify.spectra import FEWEST_BLOCKS
from hil.kinematics import jacobian
from hil.rotations import rotation_from_vector, rotation_vector_rate
from hil.signals import Array

WORDS = ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")
LINES = 12
"""Of each axis; no two axes share one."""
LOWEST_Hz = 1.0
HIGHEST = 0.1
"""Times the rate of the loop."""
PERIOD_S = 2.0
"""At least; a slow loop needs longer ones to have room for all lines."""
PERIODS = 5
RAMP_S, SETTLING_S = 0.5, 0.5
CARRIER_m = 3e-3
"""Heave, once a period: all legs move by some millimetres, and slide."""
DRIFT_m, DRIFT_Hz = 1e-3, 1e-4
"""Heave during the whole run, the straight part of a sinusoid that is never seen to turn: each period meets
the encoders' steps elsewhere, so that their rounding is noise, which averages out and shows in the standard
deviations."""


def axis_excitation(
    model: Model, pose: Pose, space: AxisSpace, rate_Hz: float, force_N: float, duration_s: float | None
) -> SinusoidReference:
    """Return sinusoids about `pose` with 12 lines on each axis, from 1 Hz to a tenth of the rate.

    The lines of an axis move it equally fast, so their accelerations grow with the frequency as what an
    encoder makes of them falls; axes load the legs equally, and the largest leg force of all is `force_N`
    beyond what holds the platform. Lines are multiples of 1/period, and neighbours belong to different axes,
    so whole periods separate the axes. A leg moves alone when the pose moves along a column of J^-1. Phases
    are Schroeder's, which keep the peak low (IEEE Trans. Inf. Theory 16, 1970). A heave of 3 mm, once a
    period, is underneath. duration_s includes fading; default: five periods.

    Raises IdentificationError: no room for four periods.
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
    harmonics = _harmonics(n, round(LOWEST_Hz * period_s), int(HIGHEST * rate_Hz * period_s))
    frequency = harmonics / period_s
    phases = -pi * np.arange(n) * (np.arange(n) - 1) / n
    axis = np.arange(n) % 6
    force, words = _directions(model, pose, space)
    acceleration = 1.0 / np.abs(force).max(axis=0)
    t = np.arange(0.0, period_s, 0.1 / frequency[-1])
    waves = np.sin(2.0 * pi * np.outer(frequency, t) + phases[:, None])
    share = frequency / frequency[-1]
    on_axes = np.array([acceleration[j] * share[axis == j] @ waves[axis == j] for j in range(6)])
    acceleration *= force_N / np.abs(force @ on_axes).max()
    duration = settled + periods * period_s
    components = [
        Sinusoid(axis="z_m", amplitude=CARRIER_m, frequency_Hz=1.0 / period_s),
        Sinusoid(
            axis="z_m",
            amplitude=DRIFT_m / (2.0 * pi * DRIFT_Hz * duration),
            frequency_Hz=DRIFT_Hz,
            phase_rad=-pi * DRIFT_Hz * duration,
        ),
    ]
    for k in range(n):
        moved = words[:, axis[k]] * acceleration[axis[k]] * share[k] / (2.0 * pi * frequency[k]) ** 2
        components += [
            Sinusoid(
                axis=word,  # type: ignore[arg-type]
                amplitude=float(f"{amplitude:.6g}"),
                frequency_Hz=float(frequency[k]),
                phase_rad=float(f"{phases[k] % (2.0 * pi):.6f}"),
            )
            for word, amplitude in zip(WORDS, moved, strict=True)
            if abs(amplitude) > 1e-6 * np.abs(moved).max()
        ]
    return SinusoidReference(
        type="sinusoids",
        centre=pose,
        components=components,
        ramp_s=RAMP_S,
        duration_s=duration,
    )


def _harmonics(n: int, lowest: int, highest: int) -> NDArray[np.int64]:
    """Return n different harmonics, spread evenly on a logarithmic scale where there is room."""
    found = np.geomspace(lowest, highest, n).round().astype(np.int64)
    for k in range(1, n):
        found[k] = max(found[k], found[k - 1] + 1)
    return found


def _directions(model: Model, pose: Pose, space: AxisSpace) -> tuple[Array, Array]:
    """Return leg forces (6, 6) N and the pose's words (6, 6) m, deg that one m or rad of each axis takes."""
    p = np.array(pose.position_m, float)
    r = np.deg2rad(np.array(pose.rotation_vector_deg, float))
    R = rotation_from_vector(r)
    J = jacobian(model.platform, p, R)
    twist = np.asarray(np.linalg.inv(J) if space == "joint" else np.eye(6), np.float64)
    words = twist.copy()
    for j in range(6):
        words[3:, j] = np.rad2deg(rotation_vector_rate(r, np.ascontiguousarray(twist[3:, j])))
    return np.asarray(np.linalg.solve(J.T, model.mass_matrix(p, R) @ twist), np.float64), words
