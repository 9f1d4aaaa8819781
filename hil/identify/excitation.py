"""A small motion about a pose that excites all legs over a wide band: to identify with, not to look at."""

from __future__ import annotations

from math import pi

import numpy as np

from drivers.arrays import Array
from hil.config import Pose, Sinusoid, SinusoidReference
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian

AXES = ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")
LINES = 6
"""Of each axis; no two axes share one, so that six legs move in six ways."""
LOWEST_Hz = 10.0
HIGHEST = 0.3
"""Times the rate of the loop."""
RAMP_S = 0.5
CARRIER_Hz, CARRIER_m = 1.0, 3e-3
"""Slow heave underneath: it keeps the legs sliding, or Coulomb friction would hold the small motion."""


def excitation(
    model: Model, pose: Pose, rate_Hz: float, force_N: float, duration_s: float
) -> SinusoidReference:
    """Return sinusoids about `pose` whose largest leg force is `force_N` beyond what holds the platform.

    All lines of an axis accelerate it equally, so each amplitude falls with the square of the frequency; the
    axes load the legs equally. A slow heave of 3 mm is underneath. Phases are Schroeder's, which keep the
    peak low (IEEE Trans. Inf. Theory 16, 1970). duration_s includes fading in and out.
    """
    n = 6 * LINES
    lines = np.round(np.geomspace(LOWEST_Hz, HIGHEST * rate_Hz, n)).astype(int)
    for k in range(1, n):
        lines[k] = max(lines[k], lines[k - 1] + 1)
    phases = -pi * np.arange(n) * (np.arange(n) - 1) / n
    axis = np.arange(n) % 6
    per_axis = _leg_forces(model, pose)  # column j: N for 1 m/s^2 or rad/s^2 on axis j
    acceleration = 1.0 / np.abs(per_axis).max(axis=0)[axis]
    t = np.arange(0.0, 1.0, 0.1 / lines[-1])
    waves = acceleration[:, None] * np.sin(2.0 * pi * np.outer(lines, t) + phases[:, None])
    on_axes = np.array([waves[axis == j].sum(axis=0) for j in range(6)])
    acceleration = acceleration * force_N / np.abs(per_axis @ on_axes).max()
    amplitude = acceleration / (2.0 * pi * lines) ** 2
    amplitude[axis >= 3] = np.rad2deg(amplitude[axis >= 3])
    return SinusoidReference(
        type="sinusoids",
        centre=pose,
        components=[
            Sinusoid(axis="z_m", amplitude=CARRIER_m, frequency_Hz=CARRIER_Hz),
            *(
                Sinusoid(
                    axis=AXES[axis[k]],  # type: ignore[arg-type]
                    amplitude=float(f"{amplitude[k]:.4g}"),
                    frequency_Hz=float(lines[k]),
                    phase_rad=float(f"{phases[k] % (2.0 * pi):.4f}"),
                )
                for k in range(n)
            ),
        ],
        ramp_s=min(RAMP_S, duration_s / 4.0),
        duration_s=duration_s,
    )


def _leg_forces(model: Model, pose: Pose) -> Array:
    """Return J^-T M (6, 6): leg forces in N for accelerations of the six axes."""
    p = np.array(pose.position_m, float)
    R = rotation_from_vector(np.deg2rad(np.array(pose.rotation_vector_deg, float)))
    return np.asarray(np.linalg.solve(jacobian(model.platform, p, R).T, model.mass_matrix(p, R)), np.float64)
