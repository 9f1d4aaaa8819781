"""The external wrench from the momentum that the commanded forces do not explain.

A. De Luca and R. Mattone, Sensorless robot collision detection and hybrid force/motion control, ICRA 2005:
with the momentum P = M twist the residual r = K (P - P(0) - integral of (J^T tau + dM/dt twist - H - G + r))
obeys dr/dt = K (wrench - r). Here the integral advances by one period at a time, and since
M1 v1 - M0 v0 = (M0 + M1)/2 (v1 - v0) + (M1 - M0) (v0 + v1)/2, its part dM/dt twist cancels against the
change of M in P: what is left of one period is

    w = mean of (M (v1 - v0)/T + H + G) at both ends - mean of J^T (tau - friction),
    r := w + (r - w) exp(-K T),

the solution of dr/dt = K (w - r) over the period. No derivative of M is needed, no acceleration is measured
beyond the difference of P, and no sum grows: nothing drifts.

tau is what the drives apply, taken from the commands through `hil.robot.force_path`: transport delay and
lag. The
feedback carries a force, too, but not in every layout, as one sample where the mean over the period is
needed, in steps of 2 N, and from another sensor on every drive.
"""

from math import pi
from typing import Any

import numpy as np

from drivers.arrays import ZERO6, Array
from drivers.compiled.compiler import INTEGER, OUT_VECTOR, REAL, VECTOR, direct, record
from drivers.signals import DriveState
from drivers.tick_columns import TICK, Record
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import add_friction, fill_jacobian, model_force
from hil.robot.force_path import ForcePath, decay

_POWERED = (DriveState.READY, DriveState.RUN)


class WrenchObserver:
    """Estimates the wrench on the platform that is not of the model: first order, `bandwidth_Hz`.

    What the model does not hold counts as external: wrong masses, friction, a drive that does not give the
    force commanded.

    Mutable state: the residual, the last state and tick, the forces under way. `reset` forgets all.
    """

    def __init__(self, model: Model, path: ForcePath, bandwidth_Hz: float) -> None:
        """path: how commands become forces."""
        self.model = model
        self._path = path
        self._left = decay(2.0 * pi * bandwidth_Hz * path.period_s)
        self.reset()

    def reset(self) -> None:
        """No load, no force under way."""
        self._path.reset()
        self._tick: int | None = None
        self._last: Record | None = None
        self.residual = ZERO6
        """(6,) N, N m: r, the estimate."""

    def sent(self, command: Array) -> None:
        """Take note of the command (6,) N that answers the last measurement."""
        self._path.send(command)

    def observe(self, tick: Record, *, seen: bool = True) -> Array:
        """Return the estimate (6,) N, N m at this tick's measurement; call it once a tick.

        While a brake is shut it carries what it carries: the estimate stays as it is, so that the force does
        not change while brakes shut one after the other, and goes on from the momentum of the first tick with
        all brakes open. A drive without force makes it zero.
        seen: the motion is measured in all directions. Where it is not, a model that is given this estimate
        carries the state on, and would confirm whatever it says: the estimate stays as it is, too.
        """
        number = int(tick["tick"])
        periods = 1 if self._tick is None else number - self._tick
        tau = self._path.advance(periods)
        self._tick = number
        drives = tick["drive_state"].tolist()
        if not all(s == DriveState.RUN for s in drives):
            self._last = None
            if not all(s in _POWERED for s in drives):
                self.residual = ZERO6
            return self.residual
        if not seen:
            self._last = None
            return self.residual
        last, self._last = self._last, tick
        if last is not None:
            w = np.empty(6)
            T = periods * self._path.period_s
            fill_unexplained(self.model.constants, self.model.code, last, tick, tau, T, w)
            self.residual = w + (self.residual - w) * self._left**periods
        return self.residual


@direct(
    VECTOR,
    INTEGER,
    record(TICK, "p", "R", "twist"),
    record(TICK, "p", "R", "twist"),
    VECTOR,
    REAL,
    OUT_VECTOR,
)
def fill_unexplained(c: Array, code: int, last: Any, tick: Any, tau: Array, T: float, w: Array) -> None:
    """Fill w (6,) N, N m, the mean over T s of M dtwist + H + G - J^T (tau - friction).

    The platform moved from the pose and twist of the last tick to those of this one; tau (6,) N is the mean
    leg force.
    """
    dtwist = (tick.twist - last.twist) / T
    w[:] = 0.0
    f, net, J = np.empty(6), np.empty(6), np.empty((6, 6))
    for end in range(2):
        p, R, twist = (last.p, last.R, last.twist) if end == 0 else (tick.p, tick.R, tick.twist)
        model_force(c, code, p, R, twist, dtwist, f)
        fill_jacobian(c, code, p, R, J)
        net[:] = tau
        add_friction(c, p, R, twist, -1.0, net)
        for j in range(6):
            total = f[j]
            for i in range(6):
                total -= J[i, j] * net[i]
            w[j] += 0.5 * total
