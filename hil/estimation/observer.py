"""Observer of the external wrench: the change of momentum that the commanded forces do not explain.

A. De Luca and R. Mattone, Sensorless robot collision detection and hybrid force/motion control, ICRA 2005:
with the momentum P = M twist the residual r = K (P - P(0) - integral of (J^T tau + dM/dt twist - H - G + r))
obeys dr/dt = K (wrench - r). Here the integral advances by one period at a time. Since M1 v1 - M0 v0 = (M0 +
M1)/2 (v1 - v0) + (M1 - M0) (v0 + v1)/2, its part dM/dt twist cancels against the change of M in P. One period
leaves

    w = mean of (M (v1 - v0)/T + H + G) at both ends - mean of J^T (tau - friction),
    r := w + (r - w) exp(-K T),

the solution of dr/dt = K (w - r) over the period. It needs no derivative of M and no measured acceleration
beyond the difference of P, and no sum grows: the estimate does not drift.

tau is the force that the drives apply, computed from the commands through `hil.robot.force_path`: transport
delay and lag. The feedback contains a force, too, but not in every layout. It is one sample instead of the
mean over the period, in steps of 2 N, and from a different sensor on every drive. Load cells between drives
and rods measure tau without friction and inertia of the drives (`estimation.wrench.forces`).
"""

from math import pi
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, REAL, VECTOR, kernel, record
from drivers.compiled.pointed import Callee, context_of, data_at, pointed, reals_at
from drivers.signals import DriveState
from drivers.tick_columns import TICK
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import SIZE, add_friction, fill_jacobian, model_force
from hil.robot.force_path import ForcePath, advance, decay, path_at

_READY, _RUN = int(DriveState.READY), int(DriveState.RUN)
OBSERVER = np.dtype(
    [
        *((name, "<i8") for name in ("path", "constants", "code", "begun", "tick", "follows")),
        ("left", "<f8"), ("patience_s", "<f8"), ("residual", "<f8", 6),
        ("p", "<f8", 3), ("R", "<f8", (3, 3)), ("twist", "<f8", 6),
    ]
)  # fmt: skip
"""Address of the record of the force path; the model; whether a tick has been seen, the last one, and whether
its p, R and twist are valid; the factor exp(-K T) of one period; oldest sample of a load cell, 0: the forces
sent count instead; and r."""


@kernel(VECTOR, INTEGER, VECTOR, MATRIX, VECTOR, VECTOR, MATRIX, VECTOR, VECTOR, REAL)
def unexplained(
    c: Array,
    code: int,
    p0: Array,
    R0: Array,
    twist0: Array,
    p1: Array,
    R1: Array,
    twist1: Array,
    tau: Array,
    T: float,
) -> Array:
    """External wrench (6,) N, N m, base frame: mean over T s of M dtwist + H + G - J^T (tau - friction).

    The platform moved from p0, R0, twist0 to p1, R1, twist1; tau (6,) N is the mean leg force, push positive.
    """
    dtwist = (twist1 - twist0) / T
    w = np.zeros(6)
    f, net, J = np.empty(6), np.empty(6), np.empty((6, 6))
    for end in range(2):
        p, R, twist = (p0, R0, twist0) if end == 0 else (p1, R1, twist1)
        model_force(c, code, p, R, twist, dtwist, f)
        fill_jacobian(c, code, p, R, J)
        net[:] = tau
        add_friction(c, p, R, twist, -1.0, net)
        for j in range(6):
            total = f[j]
            for i in range(6):
                total -= J[i, j] * net[i]
            w[j] += 0.5 * total
    return w


@pointed(
    record(OBSERVER),
    INTEGER,
    record(TICK, "tick", "drive_state", "p", "R", "twist", "force_sensor", "force_sensor_age"),
)
def observe(k: Any, seen: int, tick: Any) -> int:
    """Update the estimated external wrench with a tick's measurement; call it once per tick; returns 0.

    While a brake is shut it carries an unknown part of the load. The estimate is then kept, so that the force
    does not change while brakes shut one after the other. It continues from the momentum of the first tick
    with all brakes open. A drive that is not powered resets it to zero. seen: 1, the motion is measured in
    all directions. Otherwise the estimate is kept, too: the fusion filter would predict with this estimate
    and so confirm any value of it. It is also kept while a load cell that is used has no present sample.
    """
    path, tau = path_at(k.path), np.empty(6)
    periods = tick.tick - k.tick if k.begun else 1
    advance(path, periods, tau)
    k.begun, k.tick = 1, tick.tick
    runs = powered = True
    for i in range(6):
        runs = runs and tick.drive_state[i] == _RUN
        powered = powered and (tick.drive_state[i] == _RUN or tick.drive_state[i] == _READY)
    if not powered:
        k.residual[:] = 0.0
    known = True
    if k.patience_s > 0.0:
        tau[:] = tick.force_sensor
        for i in range(6):
            known = known and tick.force_sensor_age[i] < k.patience_s
    if not runs or not seen or not known:
        k.follows = 0
        return 0
    if k.follows:
        c, T = reals_at(k.constants, SIZE), periods * path.period_s
        w = unexplained(c, k.code, k.p, k.R, k.twist, tick.p, tick.R, tick.twist, tau, T)
        left = k.left ** float(periods)
        for i in range(6):
            k.residual[i] = w[i] + (k.residual[i] - w[i]) * left
    k.follows = 1
    k.p[:] = tick.p
    k.R[:] = tick.R
    k.twist[:] = tick.twist
    return 0


class WrenchObserver:
    """Estimates the wrench on the platform that the model does not contain, with a first-order lag.

    Its bandwidth is `bandwidth_Hz`. Everything outside the model counts as external: wrong masses, friction,
    a drive that does not apply the commanded force.

    Mutable state: the residual, the last state and tick, the forces under way. `reset` clears all.
    """

    def __init__(self, model: Model, path: ForcePath, bandwidth_Hz: float, patience_s: float = 0.0) -> None:
        """path: delay and lag from commands to acting forces; bandwidth_Hz: of the observer, Hz.

        patience_s: > 0: load cells give the forces, and this is the oldest sample of theirs.
        """
        self.model = model
        self.path = path
        left = decay(2.0 * pi * bandwidth_Hz * path.period_s)
        model_at = {"constants": model.constants, "code": model.code}
        self.record = context_of(OBSERVER, path=path.record, left=left, patience_s=patience_s, **model_at)
        self.look = Callee(observe.address, data_at(self.record), self)
        """Arguments: (observer, seen, tick), of `observe`."""
        self.residual: Array = self.record["residual"]
        """Estimated wrench r, (6,) N, N m; a view that the next tick changes."""
        self.reset()

    def reset(self) -> None:
        """Restore the initial state: no estimated wrench, and no commanded force that still has to act."""
        self.path.reset()
        for name in ("residual", "begun", "follows"):
            self.record[name] = 0
