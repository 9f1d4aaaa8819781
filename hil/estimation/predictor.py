"""Where the platform will be when the force that is computed now acts.

What happens until then is decided already: by the motion, by the forces under way, by gravity. Only the part
of the horizon after the new command's arrival is not, and there the last command is taken to go on: along a
smooth path it differs by one period's change.
"""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, VECTOR, direct, record
from drivers.tick_columns import TICK, Record, part
from hil.mathematics.rotations import cayley_step
from hil.mathematics.vectors import at, scale
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import BASE, PLATFORM, forward_dynamics_kernel
from hil.robot.force_path import ForcePath
from hil.robot.kinematics_kernels import lengths_and_jacobian


class Predictor:
    """The state a fixed time after the measurement: M dtwist + H + G = J^T (tau - friction) + wrench.

    Each command's share of the horizon is one step, second order in its length: half the way with the old
    twist, the twist's change by the mean force at the pose half way, half the way with the new one. The
    rotation moves by the Cayley map, which is orthogonal. With 1 kHz and 2 ms the steps add less than 1 um.

    Mutable state: the forces under way and the tick of the last call. `reset` forgets both.
    """

    def __init__(self, model: Model, path: ForcePath, hold_s: float) -> None:
        """path: how commands become forces; hold_s: how late, on average, a held command acts."""
        self.model = model
        self.horizon_s = path.transport_s + path.lag_s + hold_s
        self._path = path
        self._segments = path.segments(self.horizon_s)
        self._durations = np.array([segment.duration_s for segment in self._segments])
        self.reset()

    def reset(self) -> None:
        """No force under way."""
        self._path.reset()
        self._tick: int | None = None

    def sent(self, command: Array) -> None:
        """Take note of the command (6,) N that answers the last measurement."""
        self._path.send(command)

    def ahead(self, tick: Record, *, free: bool) -> None:
        """Move the state of a tick on by `horizon_s`; call it once a tick.

        free: all brakes are open. Where they are not, the platform stays where it is.
        """
        number = int(tick["tick"])
        if self._tick is not None:
            self._path.advance(number - self._tick)
        self._tick = number
        if free:
            forces, _ = self._path.follow(self._segments)
            _predict(self.model.constants, self.model.code, self._durations, np.array(forces), tick)


@direct(VECTOR, INTEGER, VECTOR, MATRIX, record(TICK, *part("estimate")))
def _predict(c: Array, code: int, durations: Array, forces: Array, tick: Any) -> None:
    """Move q, dq, p, R, twist, J on by the steps `durations` (n,) s under the `forces` (n, 6) N."""
    p, R, twist = tick.p, tick.R, tick.twist
    for n in range(durations.shape[0]):
        h = durations[n]
        for half in range(2):
            for i in range(3):
                p[i] += 0.5 * h * twist[i]
            cayley_step(R, scale(0.5 * h, at(twist, 3)))
            if half == 0:
                dtwist = forward_dynamics_kernel(c, code, p, R, twist, forces[n], tick.wrench)
                for i in range(6):
                    twist[i] += h * dtwist[i]
    a = c[BASE : BASE + 18].reshape((6, 3))
    b = c[PLATFORM : PLATFORM + 18].reshape((6, 3))
    lengths_and_jacobian(a, b, p, R, tick.q, tick.J)
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += tick.J[i, j] * twist[j]
        tick.dq[i] = total
