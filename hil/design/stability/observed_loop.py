"""Controller with an observer of the external wrench, whose estimate the law compensates.

The observer, `hil.estimation.observer`, is a second feedback, of rate and commands. It is exact if its path
from command to force is right: transport, hold, lag. In the axes of the law

::

    w[k] = -M (de[k] - de[k-1]) / T - mean of the path's force over the period before k
    r[k] = w[k] + (r[k-1] - w[k]) exp(-K T),    u[k] = law - r[k]
"""

from math import exp, pi
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.mathematics.linear_system import LinearSystem
from hil.robot.force_path import ForcePath


class Observer(NamedTuple):
    """Bandwidth of the wrench observer, and delay and lag that it assumes from command to force."""

    bandwidth_Hz: float
    transport_s: float
    lag_s: float


def observed(controller: LinearSystem, observer: Observer, mass: Array | None = None) -> LinearSystem:
    """Controller with its observer as a system from [e, de, c] to u; the controller is from [e, de (, r)].

    r (m,): estimated force. c (m,): force that only the observer sees, as the known part of a disturbance.
    mass (m, m): mass matrix of m coupled axes; default: one axis, u is an acceleration.
    """
    T = controller.period_s
    assert T is not None
    M = np.eye(1) if mass is None else mass
    m = len(M)
    if controller.B.shape[1] == 2 * m:
        B, D = np.zeros((controller.order, m)), -np.eye(m)
        controller = controller._replace(B=np.hstack([controller.B, B]), D=np.hstack([controller.D, D]))
    path = ForcePath(T, observer.transport_s, observer.lag_s)
    segments = path.segments(T, newest=1)
    n = 3 + max(each.sent for each in segments) + 1  # de[k-1], r[k-1], force, u[k-1], u[k-2], ...
    unit = np.eye(n)
    force, mean = unit[2], np.zeros(n)
    for each in segments:
        gap = force - unit[3 + each.sent]
        mean = mean + each.duration_s / T * (unit[3 + each.sent] + each.mean * gap)
        force = unit[3 + each.sent] + each.end * gap
    left = exp(-2.0 * pi * observer.bandwidth_Hz * T)
    r = left * unit[1] - (1.0 - left) * mean
    moved = np.vstack([np.zeros(n), r, force, np.zeros(n), unit[3:-1]])
    by_rate = (1.0 - left) / T * M
    estimate = np.kron(r, np.eye(m))
    estimate[:, :m] += by_rate
    A, inputs = np.kron(moved, np.eye(m)), np.zeros((n * m, 4 * m))  # e, de, c, u
    A[m : 2 * m, :m] += by_rate
    inputs[:m, m : 2 * m] = inputs[3 * m : 4 * m, 3 * m :] = np.eye(m)
    through = np.zeros((4 * m, 4 * m))  # to u, and for the controller e, de, r
    through[:m, 3 * m :] = np.eye(m)
    through[m : 3 * m, : 2 * m] = np.eye(2 * m)
    through[3 * m :, m : 2 * m] = inputs[m : 2 * m, m : 2 * m] = -by_rate
    through[3 * m :, 2 * m : 3 * m] = inputs[m : 2 * m, 2 * m : 3 * m] = (1.0 - left) * np.eye(m)
    outputs = np.vstack([np.zeros((3 * m, n * m)), estimate])
    return LinearSystem(A, inputs, outputs, through, T).closed_with(controller)
