"""Estimates the delay from commanded to acting leg force, as a transport delay and a first-order lag.

The leg forces follow from two sources: from the commands, through a transport delay and a first-order lag
(`hil.robot.force_path`), and from the motion, through the rigid-body model. The mean force over a period is
the one that changes the momentum as observed. Both are compared period by period and leg by leg,

    needed = gain * force(transport, lag) + offset - viscous * rate - coulomb * sgn(rate),

over periods in which the leg slides, since a leg that sticks hides any force. Gain, offset and friction of
each leg absorb model errors but do not change the time. Transport and lag, common to all legs, minimise the
sum of squares (separable least squares: Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973). Both delay, but
only the lag attenuates high frequencies: slow motion determines only their sum.

Standard deviations are those of all parameters together, linearised at the least squares, for coloured
residuals (`coloured_covariance`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from drivers.arrays import ZERO6, Array, Flags
from drivers.errors import IdentificationError
from hil.estimation.observer import unexplained
from hil.lab.identify.estimators.axis_fit import SURE_S, Delays
from hil.lab.identify.estimators.body_fit import coloured_covariance
from hil.robot.dynamics import SLIDING_SPEED, Model
from hil.robot.kinematics_kernels import jacobian_kernel

LONGEST_PERIODS = 8.0
"""Longest delay considered, in periods."""
FEWEST_PERIODS = 100
"""Least number of usable periods of motion per leg."""
STARTS = [(transport, lag) for transport in (0.25, 1.5, 3.5) for lag in (0.1, 1.0)]
"""Start values of the search: transport and lag, in periods."""


class Motion(NamedTuple):
    """Commands and motion of a run, one element per consecutive tick."""

    period_s: float
    tau: Array
    """(n, 6) N, the commands computed from each tick's measurement."""
    p: Array
    """(n, 3) m, platform position, base frame."""
    R: Array
    """(n, 3, 3) rotation, platform to base."""
    twist: Array
    """(n, 6) m/s, rad/s, twist of the platform's origin, base frame."""
    rate: Array
    """(n, 6) m/s, leg rates."""
    usable: Flags
    """(n - 1,): brakes open and all legs fresh at both ends of the period after each tick."""


class Delay(NamedTuple):
    """Identified delays from command to force, and how well the commands explain the motion."""

    delays: Delays
    explained: float
    """Explained share of the varying force, 0 .. 1."""
    gain: Array
    """(6,) ratio of needed to commanded force; 1 if model and drives agree."""
    periods: int
    """Usable periods of the leg that moved least."""


def force_delay(motion: Motion, model: Model) -> Delay:
    """Estimate the delays from commanded to acting force.

    Raises IdentificationError: too little motion, or forces that the commands do not explain.
    """
    T, fit = motion.period_s, _Fit(motion, needed_forces(motion, model))
    periods = min(map(len, fit.rows))
    if periods < FEWEST_PERIODS:
        raise IdentificationError(
            f"too little motion: a leg moves faster than {1e3 * SLIDING_SPEED:g} mm/s in {periods} periods "
            f"with open brakes and fresh legs, allowed: at least {FEWEST_PERIODS}"
        )
    found, covariance = fit.search(STARTS)
    std = T * np.sqrt(np.diag(covariance))
    # at its bound the slope of a delay is meaningless
    at_end = found[0] < 1e-3 and found[1] > 0.02
    if at_end or not std.max() <= SURE_S:
        found, covariance = fit.search([(float(found.sum()),)])
        std = np.append(T * np.sqrt(covariance[0]), 0.0)
    total_std = T * float(np.sqrt(covariance.sum()))
    varying = sum(((fit.needed[k] - fit.needed[k].mean()) ** 2).sum() for k in fit.rows)
    explained = 1.0 - float((fit.residual(found) ** 2).sum() / varying)
    if not (explained > 0.5 and total_std <= SURE_S):
        raise IdentificationError(
            f"the commands explain {100 * max(explained, 0.0):.0f} % of the varying forces and the delay is "
            f"known to {1e3 * total_std:.2g} ms: too little excitation, or another robot than the model's"
        )
    transport, lag = (T * np.append(found, 0.0)[:2]).tolist()
    delays = Delays(transport, float(std[0]), lag, float(std[1]), transport + lag + 0.5 * T, total_std)
    return Delay(delays, explained, fit.coefficients(found)[:, 0], periods)


def needed_forces(motion: Motion, model: Model) -> Array:
    """Mean leg forces (n - 1, 6) N that the motion of each period required; nan if not usable."""
    found = np.full((len(motion.tau) - 1, 6), np.nan)
    a, b = model.platform.base_joints, model.platform.platform_joints
    for k in np.flatnonzero(motion.usable):
        ends = [(motion.p[n], motion.R[n], motion.twist[n]) for n in (k, k + 1)]
        w = unexplained(model.constants, model.code, *ends[0], *ends[1], ZERO6, motion.period_s)
        J = np.mean([jacobian_kernel(a, b, p, R) for p, R, _ in ends], axis=0)
        found[k] = np.linalg.solve(J.T, w)
    return found


def mean_forces(tau: Array, period_s: float, transport_s: float, lag_s: float) -> Array:
    """Mean acting force (n - 1, 6) N over the period after each tick; see `hil.robot.force_path`.

    tau (n, 6) N: commands; before the first tick the first command applies.
    """
    whole = int(transport_s / period_s)
    first = transport_s - whole * period_s
    late = np.vstack([np.repeat(tau[:1], whole + 1, axis=0), tau])
    n = len(tau) - 1
    old, new = late[:n], late[1 : n + 1]
    if lag_s < 1e-3 * period_s:
        return (first * old + (period_s - first) * new) / period_s
    x, y = first / lag_s, (period_s - first) / lag_s
    e, d = np.exp(-x), np.exp(-y)
    driven = d * (1.0 - e) * (old - tau[0]) + (1.0 - d) * (new - tau[0])
    after = np.asarray(lfilter([1.0], [1.0, -e * d], driven, axis=0), np.float64)
    force = np.vstack([np.zeros((1, 6)), after[:-1]]) + tau[0]
    half = old + (force - old) * e
    area = lag_s * ((force - old) * (1.0 - e) + (half - new) * (1.0 - d))
    return np.asarray((first * old + (period_s - first) * new + area) / period_s, np.float64)


class _Fit:
    """Separable least squares over one log: a row for each leg and period in which the leg slides one way.

    Delays x are (transport,) or (transport, lag), in periods.
    """

    def __init__(self, motion: Motion, needed: Array) -> None:
        self._motion = motion
        before, after = motion.rate[:-1], motion.rate[1:]
        slides = np.minimum(np.abs(before), np.abs(after)) > SLIDING_SPEED
        slides &= (before * after > 0.0) & motion.usable[:, None]
        self._sample, self._leg = np.nonzero(slides)
        self.rows = [np.flatnonzero(self._leg == leg) for leg in range(6)]
        rate = 0.5 * (before + after)[slides]
        self.needed, self._friction = needed[slides], -np.column_stack([rate, np.sign(rate)])

    def _regressors(self, x: Sequence[float] | Array) -> Array:
        T, (transport, lag) = self._motion.period_s, (*x, 0.0)[:2]
        force = mean_forces(self._motion.tau, T, transport * T, lag * T)[self._sample, self._leg]
        return np.column_stack([force, np.ones(len(self.needed)), self._friction])

    def coefficients(self, x: Sequence[float] | Array) -> Array:
        """Gain, offset N, viscous N s/m and Coulomb N friction (6, 4) of the legs for given delays."""
        A = self._regressors(x)
        return np.array([np.linalg.lstsq(A[k], self.needed[k], rcond=None)[0] for k in self.rows])

    def residual(self, x: Sequence[float] | Array) -> Array:
        """Needed minus modelled force (m,) N for given delays, one row per leg and period."""
        of_rows = self.coefficients(x)[self._leg]
        return np.asarray(self.needed - (self._regressors(x) * of_rows).sum(axis=1), np.float64)

    def search(self, starts: Sequence[tuple[float, ...]]) -> tuple[Array, Array]:
        """Delays, periods, of the smallest residual over several starts; their covariance, inf: unknown."""
        fits = [
            least_squares(
                self.residual,
                np.clip(start, 1e-3, LONGEST_PERIODS - 1e-3),
                bounds=(0.0, LONGEST_PERIODS),
                diff_step=1e-3,
                xtol=1e-7,
            )
            for start in starts
        ]
        best = min(fits, key=lambda fit: float(fit.cost))
        if np.linalg.matrix_rank(best.jac) < len(best.x):
            return best.x, np.full((len(best.x), len(best.x)), np.inf)
        return best.x, coloured_covariance(best.jac, best.fun, self._sample)
