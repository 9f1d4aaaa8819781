"""The linearised axes in a log: the acceleration that was demanded of each, and where it was.

A law that linearises sends tau = A(x) v + b(x), x the measured state, for a demanded acceleration v. So v
follows from what was sent, limits included, whatever made v: reference, gains, a switching term.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Flags
from drivers.tick_columns import Record, new_record
from hil.config.axis_model import AxisSpace
from hil.control.inverse_dynamics import linearising_tau
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import inverse_dynamics_kernel
from hil.robot.kinematics_kernels import jacobian_kernel

Law = Callable[[Model, Record, Array], Array]


class AxisSignals(NamedTuple):
    """Six axes of a run, one row a tick, all ticks in a row."""

    period_s: float
    v: Array
    """(n, 6) m/s^2, rad/s^2: acceleration that the forces sent demand."""
    y: Array
    """(n, 6) m, rad: measured position."""
    r: Array
    """(n, 6) m/s^2, rad/s^2: acceleration of the reference."""
    good: Flags
    """(n,): tracking, recorded, and all six legs fresh."""


def demanded_accelerations(space: AxisSpace, model: Model, states: list[Record], tau: Array) -> Array:
    """Return v (n, 6) for which the law of `model` sends tau (n, 6) N in each state.

    joint: accelerations of the legs, m/s^2; pose: of x, y, z and the rotations about them, m/s^2 and rad/s^2.
    A and b are taken from the law's own kernel, so every variant of the model is its own inverse.
    """
    law, still = _LAWS[space], np.zeros(6)
    axes = np.eye(6)
    b = np.array([law(model, state, still) for state in states])
    A = np.array([[law(model, state, axis) for axis in axes] for state in states]) - b[:, None, :]
    return np.linalg.solve(A.transpose(0, 2, 1), (tau - b)[:, :, None])[:, :, 0]


def state_of(model: Model, p: Array, R: Array, twist: Array, wrench: Array) -> Record:
    """Return a tick with what a law's kernels read of the state, from a row of the log."""
    tick = new_record()
    tick["p"], tick["R"], tick["twist"], tick["wrench"] = p, R, twist, wrench
    tick["J"] = jacobian_kernel(model.platform.base_joints, model.platform.platform_joints, p, R)
    return tick


def _pose(model: Model, tick: Record, v: Array) -> Array:
    return inverse_dynamics_kernel(
        model.constants, model.code, tick["p"], tick["R"], tick["twist"], v, tick["wrench"]
    )


_LAWS: dict[AxisSpace, Law] = {"joint": linearising_tau, "pose": _pose}
