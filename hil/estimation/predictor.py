"""Prediction of the platform's state at the time when the force that is computed now acts.

The motion until then is determined already: by the present motion, the forces under way, and gravity. Only
the part of the horizon after the arrival of the new command is open. There the last command is assumed to
continue: along a smooth path the error is one period's change.
"""

from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import Callee, context_of, data_at, pointed, reals_at
from drivers.tick_columns import TICK, part
from hil.mathematics.rotations import cayley_step
from hil.mathematics.vectors import at, scale
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import BASE, PLATFORM, SIZE, forward_dynamics_kernel
from hil.robot.force_path import SEGMENT, ForcePath, advance, as_records, follow, path_at
from hil.robot.kinematics_kernels import lengths_and_jacobian

PREDICTOR = np.dtype(
    [(name, "<i8") for name in ("path", "segments", "count", "constants", "code", "begun", "tick")]
)
"""Address of the record of the force path; the segments of the horizon, and their number; the model; whether
a tick has been seen, and the last one."""
_SEGMENT_BYTES = SEGMENT.itemsize


@pointed(record(PREDICTOR), INTEGER, record(TICK, "tick", *part("estimate")))
def ahead(k: Any, free: int, tick: Any) -> int:
    """Advance a tick's q, dq, p, R, twist, J to the time at which its force will act; returns 0.

    Call it once per tick. free: 1, all brakes are open. Otherwise the platform stays at its pose.
    """
    path = path_at(k.path)
    force, mean = np.empty(6), np.empty(6)
    if k.begun:
        advance(path, tick.tick - k.tick, mean)
    k.begun, k.tick = 1, tick.tick
    if not free:
        return 0
    c = reals_at(k.constants, SIZE)
    p, R, twist = tick.p, tick.R, tick.twist
    force[:] = path.force
    for n in range(k.count):
        h = follow(path, k.segments + _SEGMENT_BYTES * n, force, mean)
        for half in range(2):
            for i in range(3):
                p[i] += 0.5 * h * twist[i]
            cayley_step(R, scale(0.5 * h, at(twist, 3)))
            if half == 0:
                dtwist = forward_dynamics_kernel(c, k.code, p, R, twist, mean, tick.wrench)
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
    return 0


class Predictor:
    """The state a fixed time after the measurement: M dtwist + H + G = J^T (tau - friction) + wrench.

    Each command's share of the horizon is one step, second order in its length: half the way with the old
    twist, the change of the twist by the mean force at the midpoint pose, half the way with the new twist.
    The rotation moves by the Cayley map, which is orthogonal. With 1 kHz and 2 ms the steps add less than 1
    um.

    Mutable state: the forces under way and the tick of the last call. `reset` forgets both.
    """

    def __init__(self, model: Model, path: ForcePath, hold_s: float) -> None:
        """path: delay and lag from commands to acting forces; hold_s: mean delay of a held command, s."""
        self.model = model
        self.horizon_s = path.transport_s + path.lag_s + hold_s
        self.path = path
        self._segments = as_records(path.segments(self.horizon_s))
        places = {"path": path.record, "segments": self._segments, "constants": model.constants}
        self.record = context_of(PREDICTOR, count=len(self._segments), code=model.code, **places)
        self.look = Callee(ahead.address, data_at(self.record), self)
        """Arguments: (predictor, free, tick), of `ahead`."""
        self.reset()

    def reset(self) -> None:
        """Restore the initial state: no commanded force that still has to act."""
        self.path.reset()
        self.record["begun"] = 0
