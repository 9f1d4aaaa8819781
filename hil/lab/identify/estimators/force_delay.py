"""The delay from command to force.

The leg forces are known twice: from the commands, through a transport delay and a first-order lag
(`hil.robot.force_path`), and from the motion, through the rigid-body model: the mean force over a period is
the one that changes the momentum as observed. The two are compared period by period and leg by leg,

    needed = gain * force(transport, lag) + offset - viscous * rate - coulomb * sgn(rate),

over periods in which the leg slides: a leg that sticks hides any force. Gain, offset and friction of each leg
absorb the errors of the model; they do not change the time. Where masses or drives are off, the friction is
viscous / gain and coulomb / gain in the force that the drive makes: that is what is returned. Transport and
lag, common to all legs, minimise the sum of squares (separable least squares: Golub and Pereyra, SIAM J.
Numer. Anal. 10, 1973). Both delay, but only the lag attenuates high frequencies: slow motion gives their sum
alone.

Standard deviations are those of a delete-a-block jackknife over time (Kuensch, Ann. Statist. 17, 1989), which
needs neither white nor equal noise.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

from drivers.arrays import ZERO6, Array, Flags
from drivers.errors import IdentificationError
from hil.estimation.observer import unexplained
from hil.robot.dynamics import SLIDING_SPEED, Model
from hil.robot.kinematics_kernels import jacobian_kernel

BLOCKS = 10
"""Of the jackknife."""
LONGEST_PERIODS = 8.0
"""Longest delay considered, in periods."""
FEWEST_PERIODS = 100
"""Usable periods of motion that each leg needs."""
SURE_S = 2e-4
"""Largest standard deviation, s, of a delay that is reported."""


class Motion(NamedTuple):
    """Commands and motion of a run, one element a tick, all ticks in a row."""

    period_s: float
    tau: Array
    """(n, 6) N, the commands that answer each tick's measurement."""
    p: Array
    """(n, 3) m."""
    R: Array
    """(n, 3, 3)."""
    twist: Array
    """(n, 6)."""
    rate: Array
    """(n, 6) m/s, leg rates."""
    usable: Flags
    """(n - 1,): brakes open and all legs fresh at both ends of the period after each tick."""


class Delay(NamedTuple):
    """From measurement to force, s, with standard deviations."""

    transport_s: float
    transport_std_s: float
    lag_s: float
    lag_std_s: float
    hold_s: float
    """Half a period; known."""
    total_s: float
    total_std_s: float
    separable: bool
    """Whether transport and lag could be separated; if not, lag is 0 and transport is their sum."""
    explained: float
    """Share of the varying force that is explained, 0 .. 1."""
    gain: Array
    """(6,) of each leg: 1 where model and drives agree."""
    viscous: Array
    """(6,) N s/m of the drive's own force, beyond the model's."""
    viscous_std: Array
    coulomb: Array
    """(6,) N of the drive's own force, beyond the model's."""
    coulomb_std: Array
    periods: int
    """In which the leg that moved least was used."""


def force_delay(motion: Motion, model: Model) -> Delay:
    """Estimate the delays from commanded to acting force.

    Raises IdentificationError: too little motion, or nothing in it that the commands explain.
    """
    fit = _Fit(motion, needed_forces(motion, model))
    periods = int((motion.usable[:, None] & fit.slides).sum(axis=0).min())
    if periods < FEWEST_PERIODS:
        raise IdentificationError(
            f"too little motion: a leg moves faster than {1e3 * SLIDING_SPEED:g} mm/s in {periods} periods "
            f"with open brakes and fresh legs, allowed: at least {FEWEST_PERIODS}"
        )
    everything = np.flatnonzero(motion.usable)
    transport, lag = fit.both(everything)
    samples = np.array([fit.both(rest, (transport, lag)) for rest in _without_blocks(everything)])
    (transport_std, lag_std), total_std = _jackknife(samples), float(_jackknife(samples.sum(axis=1)))
    # At the end of what is possible a spread of zero says nothing.
    at_end = transport < 1e-3 * motion.period_s and lag > 0.02 * motion.period_s
    separable = bool(max(transport_std, lag_std) <= SURE_S) and not at_end
    if not separable:
        transport, lag = fit.transport(everything, transport + lag), 0.0
        samples = np.array([fit.transport(rest, transport) for rest in _without_blocks(everything)])
        transport_std, lag_std = float(_jackknife(samples)), 0.0
        total_std = transport_std
    explained, coefficients = fit.quality(transport, lag, everything)
    gain, _, viscous, coulomb = _of_the_drive(coefficients).T
    spread = _jackknife(
        np.array([
            _of_the_drive(fit.quality(transport, lag, rest)[1]) for rest in _without_blocks(everything)
        ])
    )  # fmt: skip
    if not (explained > 0.5 and total_std <= SURE_S):
        raise IdentificationError(
            f"the commands explain {100 * max(explained, 0.0):.0f} % of the varying forces and the delay is "
            f"known to {1e3 * total_std:.2g} ms: too little excitation, or another robot than the model's"
        )
    hold = 0.5 * motion.period_s
    return Delay(
        transport, float(transport_std), lag, float(lag_std), hold, transport + lag + hold, total_std,
        separable, explained, gain, viscous, spread[:, 2], coulomb, spread[:, 3], periods,
    )  # fmt: skip


def needed_forces(motion: Motion, model: Model) -> Array:
    """Return the mean leg forces (n - 1, 6) N that the motion of each period took; nan where not usable."""
    found = np.full((len(motion.tau) - 1, 6), np.nan)
    a, b = model.platform.base_joints, model.platform.platform_joints
    for k in np.flatnonzero(motion.usable):
        ends = [(motion.p[n], motion.R[n], motion.twist[n]) for n in (k, k + 1)]
        w = unexplained(model.constants, model.code, *ends[0], *ends[1], ZERO6, motion.period_s)
        J = np.mean([jacobian_kernel(a, b, p, R) for p, R, _ in ends], axis=0)
        found[k] = np.linalg.solve(J.T, w)
    return found


def mean_forces(tau: Array, period_s: float, transport_s: float, lag_s: float) -> Array:
    """Return the mean force (n - 1, 6) N over the period after each tick; see `hil.robot.force_path`.

    tau (n, 6) N, commands; before the first one, the force was as that.
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
    """The separable least squares of one log."""

    def __init__(self, motion: Motion, needed: Array) -> None:
        self.motion, self.needed = motion, needed
        self.rate = 0.5 * (motion.rate[1:] + motion.rate[:-1])
        self.sign = np.sign(self.rate)
        fast = np.minimum(np.abs(motion.rate[1:]), np.abs(motion.rate[:-1])) > SLIDING_SPEED
        self.slides = fast & (motion.rate[1:] * motion.rate[:-1] > 0.0)
        """(n - 1, 6): the leg moves one way over the whole period."""

    def residual(self, transport_s: float, lag_s: float, use: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return residuals (m,) N and the coefficients (6, 4): gain, offset, viscous, coulomb."""
        force = mean_forces(self.motion.tau, self.motion.period_s, transport_s, lag_s)
        residuals, coefficients = [], []
        for leg in range(6):
            k = use[self.slides[use, leg]]
            A = np.column_stack([force[k, leg], np.ones(len(k)), -self.rate[k, leg], -self.sign[k, leg]])
            c, *_ = np.linalg.lstsq(A, self.needed[k, leg], rcond=None)
            residuals.append(self.needed[k, leg] - A @ c)
            coefficients.append(c)
        return np.concatenate(residuals), np.array(coefficients)

    def both(self, use: NDArray[np.intp], start: tuple[float, float] | None = None) -> tuple[float, float]:
        """Return transport and lag, s, from the best of a few starts, or from one."""
        T = self.motion.period_s
        starts = [start] if start else [(a * T, b * T) for a in (0.25, 1.5, 3.5) for b in (0.1, 1.0)]
        fits = [
            least_squares(
                lambda x: self.residual(x[0] * T, x[1] * T, use)[0],
                np.clip(np.array(each) / T, 1e-3, LONGEST_PERIODS - 1e-3),
                bounds=(0.0, LONGEST_PERIODS),
                x_scale=1.0,
                xtol=1e-7,
            )
            for each in starts
        ]
        best = min(fits, key=lambda fit: float(fit.cost))
        return float(best.x[0]) * T, float(best.x[1]) * T

    def transport(self, use: NDArray[np.intp], start: float) -> float:
        """Return the delay, s, if all of it is transport."""
        T = self.motion.period_s
        fit = least_squares(
            lambda x: self.residual(x[0] * T, 0.0, use)[0],
            [min(max(start / T, 1e-3), LONGEST_PERIODS - 1e-3)],
            bounds=(0.0, LONGEST_PERIODS),
        )
        return float(fit.x[0]) * T

    def quality(self, transport_s: float, lag_s: float, use: NDArray[np.intp]) -> tuple[float, Array]:
        """Return the explained share of the forces' variance, and the coefficients (6, 4)."""
        residuals, coefficients = self.residual(transport_s, lag_s, use)
        varying = 0.0
        for leg in range(6):
            needed = self.needed[use[self.slides[use, leg]], leg]
            varying += float(((needed - needed.mean()) ** 2).sum())
        explained = 1.0 - float((residuals**2).sum()) / varying
        return explained, coefficients


def _of_the_drive(coefficients: Array) -> Array:
    """Return gain, offset, viscous and coulomb (6, 4) with the frictions as forces that the drive makes."""
    found = coefficients.copy()
    found[:, 2:] /= coefficients[:, :1]
    return found


def _without_blocks(use: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Return the periods without the first tenth, without the second, and so on."""
    blocks = np.array_split(use, BLOCKS)
    return [np.concatenate(blocks[:k] + blocks[k + 1 :]) for k in range(BLOCKS)]


def _jackknife(samples: Array) -> Array:
    """Return the standard deviation of the whole's estimate from those without each block."""
    n = len(samples)
    spread: Array = np.sqrt((n - 1) / n * ((samples - samples.mean(axis=0)) ** 2).sum(axis=0))
    return spread
