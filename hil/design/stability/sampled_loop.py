"""The loop with sampling, hold and delay: axis, controllers, eigenvalues, margins and peak gains.

The axis is gain exp(-transport s) D(s) / s^2 behind a hold of one period, D the force loop of the drives,
from requested acceleration to position and rate at the instants of measurement. The axis is a linearised
robot seen through bus, drives and sampling; the transport may be a fraction of a period. The controller
computes u from y = [e, de], and the loop is closed by e = -position. The eigenvalues of the loop decide
exactly, with all delays, whether the sampled loop is stable.
"""

from collections.abc import Callable, Iterator, Sequence
from math import ceil, floor, inf, pi
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, ComplexArray
from hil.config.linear_controller import LinearController
from hil.mathematics.linear_system import LinearSystem, exponential, held, lag, static

SLOWEST = 1e-5
"""Lowest frequency of the margins, as a share of the Nyquist frequency."""


class Axis(NamedTuple):
    """One axis of a linearised loop: sampling period, delay, drive lag and gain."""

    period_s: float
    transport_s: float = 0.0
    """Pure delay from the instant of measurement to the force computed from it."""
    lag_s: float = 0.0
    """Time constant, s, of the drives' force, first order; 0: no lag."""
    gain: float = 1.0
    """Acceleration of the axis over the requested one; 1 for an exact model."""


def sampled_axis(
    transport_s: float,
    drive: LinearSystem,
    period_s: float,
    gain: float | Array = 1.0,
    stiffness: Array | None = None,
) -> LinearSystem:
    """Sampled axes: a system from held accelerations to positions and rates, its first states.

    `drive` is the continuous force loop of each axis: `hil.mathematics.linear_system.lag`, or of higher
    order. gain: of one axis, or (m, m): accelerations of m axes per force of each. The axes may then have a
    stiffness (m, m) of their own, which acts without delay.
    """
    mobility = np.atleast_2d(gain)
    m = len(mobility)
    n = 2 * m + m * drive.order
    A, B, each = np.zeros((n, n)), np.zeros((n, m)), np.eye(m)  # of positions, rates, and the drives
    A[:m, m : 2 * m] = each
    if stiffness is not None:
        A[m : 2 * m, :m] = -mobility @ stiffness
    A[m : 2 * m, 2 * m :], B[m : 2 * m] = mobility @ np.kron(each, drive.C), mobility @ np.kron(each, drive.D)
    A[2 * m :, 2 * m :], B[2 * m :] = np.kron(each, drive.A), np.kron(each, drive.B)
    whole = ceil(transport_s / period_s - 1e-9)
    late = max(whole * period_s - transport_s, 0.0)  # so long before the sample the newer input already acts
    _, newer = held(A, B, late)
    Phi, both = held(A, B, period_s)
    end = n + (whole + 1) * m  # columns: the state, then the inputs from the newest to the oldest
    FG = np.vstack([np.zeros((n, end)), np.eye(whole * m, end, k=n)])
    FG[:n, :n], FG[:n, end - m :] = Phi, both - newer
    FG[:n, end - 2 * m : end - m] += newer  # zero without a delay
    F, G = np.delete(FG, np.s_[n : n + m], axis=1), FG[:, n : n + m]
    return LinearSystem(F, G, np.eye(2 * m, end - m), np.zeros((2 * m, m)), period_s)


def disturbed(axis: LinearSystem) -> LinearSystem:
    """`sampled_axis` with a second input: a disturbing acceleration, held for a period, without delay."""
    T = axis.period_s
    assert T is not None
    push = np.zeros((axis.order, 1))
    push[:2, 0] = T * T / 2.0, T
    return axis._replace(B=np.hstack([axis.B, push]), D=np.zeros((2, 2)))


def disturbed_axis(axis: Axis) -> LinearSystem:
    """Sampled axis from u[k] and a disturbing acceleration d[k], both held, to position and rate."""
    return disturbed(sampled_axis(axis.transport_s, lag(axis.lag_s), axis.period_s, axis.gain))


def gains(K_P: float, K_D: float, period_s: float) -> LinearSystem:
    """Proportional-derivative controller u = K_P e + K_D de."""
    return static(np.array([[K_P, K_D]]), period_s)


def predicting(
    K_P: float,
    K_D: float,
    period_s: float,
    *,
    bus_s: float,
    lag_s: float,
    hold_s: float,
    estimated: bool = False,
) -> LinearSystem:
    """Predictive controller from [e, de]: u[k] = K_P e + K_D de at bus + lag + hold after the measurement.

    The prediction integrates e'' = -a with the commands already sent; the last one is assumed to continue. a
    is the acceleration of the force, which follows the commands by its lag. States: a if there is a lag, and
    the last commands u[k-1], u[k-2], ... estimated: adds a third input r, the estimated
    disturbance: the prediction integrates e'' = -a - r, and u compensates r.
    """
    T, horizon = period_s, bus_s + lag_s + hold_s
    m = floor(bus_s / T + 1e-9)
    r = max(bus_s - m * T, 0.0)
    n = 3 if lag_s > 0.0 else 2
    size = n + m + 3  # e, de, a, u[k], u[k-1], ..., u[k-m-1], r

    def moved(acting: list[tuple[int, float]]) -> Array:
        """Transition matrix of the state while u[k-j] acts for the time given, one after the other."""
        Phi = np.eye(size)
        for j, time_s in acting:
            F = np.zeros((size, size))
            F[0, 1], F[1, -1] = 1.0, -1.0
            if lag_s > 0.0:
                F[1, 2], F[2, 2], F[2, n + j] = -1.0, -1.0 / lag_s, 1.0 / lag_s
            else:
                F[1, n + j] = -1.0
            Phi = exponential(F * time_s) @ Phi
        return Phi

    ends = np.minimum([0.0, *(r + j * T for j in range(m)), horizon], horizon)
    ahead = moved([(m + 1 - j, float(time_s)) for j, time_s in enumerate(np.diff(ends))])
    K = np.array([K_P, K_D]) @ ahead[:2]
    C, D = np.delete(K, n)[None, 2:-1], np.array([[K[0], K[1], K[-1] - 1.0]])
    count = C.shape[1]
    A, B = np.eye(count, k=-1), np.zeros((count, 3))
    A[n - 2], B[n - 2] = C[0], D[0]
    if lag_s > 0.0:
        late = moved([(m + 1, r), (m, T - r)])[2]
        A[0] = np.delete(late, n)[2:-1] + late[n] * C[0]
        B[0] = late[n] * D[0]
    inputs = 3 if estimated else 2
    return LinearSystem(A, B[:, :inputs], C, D[:, :inputs], T)


def sampled_controller(controller: LinearController) -> LinearSystem:
    """System from [e, de] to u of the linear controller in a file."""
    chosen = np.eye(2)[[("error", "rate_error").index(name) for name in controller.inputs]]
    n, m = len(controller.A), len(controller.inputs)
    B = np.array(controller.B, float).reshape(n, m) @ chosen
    A, C = np.array(controller.A, float).reshape(n, n), np.array(controller.C, float)
    return LinearSystem(A, B, C, np.array(controller.D, float) @ chosen, 1.0 / controller.rate_Hz)


class Margins(NamedTuple):
    """Stability margins of a stable loop, each for one change at a time; inf: unlimited."""

    gain_up: float
    """Largest factor on the loop gain that keeps the loop stable."""
    gain_down: float
    """Smallest factor on the loop gain that keeps the loop stable; 0: no lower limit."""
    phase_deg: float
    delay_s: float
    """Largest additional pure delay, s, that keeps the loop stable."""
    crossover_rad_s: float
    """The highest frequency at which the loop's gain is 1; 0: none."""
    peak_S: float
    """Peak of |1 / (1 + L)|, the inverse of the smallest distance between L and -1."""
    peak_T: float
    """Peak of |L / (1 + L)| over frequency."""


def grid(period_s: float) -> Array:
    """Frequencies, rad/s, up to the Nyquist frequency: about 4000, logarithmic and linear together."""
    top = pi / period_s
    return np.unique(
        np.concatenate([np.geomspace(SLOWEST * top, top, 2500), np.linspace(1e-3 * top, top, 1500)])
    )


def root(f: Callable[[float], float], low: float, high: float) -> float:
    """Zero of a continuous function with different signs at `low` and `high`, by bisection."""
    begins = f(low) > 0.0
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if (f(middle) > 0.0) == begins else (low, middle)
    return high


def crossings(loci: Callable[[Array], ComplexArray], omega: Array) -> Iterator[tuple[float, float]]:
    """Yield each frequency, rad/s, at which a locus (n, k) has magnitude 1, and its angle, rad, from -1."""
    size = np.abs(loci(omega))
    for i, k in np.argwhere(np.diff(np.sign(size - 1.0), axis=0) != 0):

        def at(w: float, k: int = k) -> complex:
            return complex(loci(np.array([w]))[0, k])

        w = root(lambda w: abs(at(w)) - 1.0, omega[i], omega[i + 1])
        yield w, float(np.angle(at(w))) + pi


def crossing_margins(loci: Callable[[Array], ComplexArray], omega: Array) -> tuple[float, float, float]:
    """Delay margin, s, crossover, rad/s, and phase margin, deg, of a stable loop; loci: (n, k) at omega."""
    met = list(crossings(loci, omega))  # what may still be lost until -1 is in 0 .. 2 pi
    phase = min((min(left, 2.0 * pi - left) for _, left in met), default=inf)
    delay = min((left / w for w, left in met), default=inf)
    return delay, max((w for w, _ in met), default=0.0), float(np.degrees(phase))


def margins(loop: LinearSystem) -> Margins:
    """Margins of a stable sampled loop L with one input and one output; 1 + L(z) = 0 is the limit."""
    assert loop.period_s is not None

    def L(omega: Array) -> ComplexArray:
        return np.asarray(loop.response(omega)[:, :, 0], np.complex128)

    omega = grid(loop.period_s)
    value = L(omega)[:, 0]
    at_real = [value[-1].real]  # at half the rate the response is real
    for k in np.flatnonzero(np.diff(np.sign(value.imag[:-1])) != 0):
        w = root(lambda w: L(np.array([w]))[0, 0].imag, omega[k], omega[k + 1])
        at_real.append(L(np.array([w]))[0, 0].real)
    factors = [-1.0 / real for real in at_real if real < 0.0]
    delay_s, crossover, phase_deg = crossing_margins(L, omega)
    return Margins(
        min((f for f in factors if f > 1.0), default=inf),
        max((f for f in factors if f <= 1.0), default=0.0),
        phase_deg,
        delay_s,
        crossover,
        float(np.abs(1.0 / (1.0 + value)).max()),
        float(np.abs(value / (1.0 + value)).max()),
    )


class Sampled(NamedTuple):
    """Analysis of a sampled loop: poles, margins, and responses to disturbances."""

    poles: ComplexArray
    """(n,) poles of the closed loop, in z."""
    margins: Margins | None
    """Stability margins; None if the loop is not stable."""
    loop: LinearSystem
    """System to e, de and u from a disturbing acceleration, held over each period, from measurement errors of
    e and de at each sample, and, with an observer, from an acceleration that only the observer sees.
    """

    @property
    def largest(self) -> float:
        """Largest magnitude |z| of the poles; the loop is stable if it is below 1."""
        return float(np.abs(self.poles).max())

    @property
    def decay_rate(self) -> float:
        """Decay rate of the slowest mode, 1/s, -log |z| over the period; below 0 if it grows."""
        assert self.loop.period_s is not None
        return float(-np.log(max(self.largest, 1e-300)) / self.loop.period_s)

    @property
    def stable(self) -> bool:
        """True if all poles z lie inside the unit circle."""
        return bool((np.abs(self.poles) < 1.0).all())

    def peak_gains(self, slope: float = 0.0) -> Array:
        """Peak gains (4,) to |e| s^2, |de| s, |u| and |de + slope e| s, at each measurement.

        They hold for every bounded acceleration, with changes at any time: the weight h(s) of the
        acceleration at time s before a measurement is linear in s over each period, so its area is exact. inf
        if not stable.
        """
        if not self.stable:
            return np.full(4, inf)
        T = self.loop.period_s
        assert T is not None
        x = np.zeros((len(self.poles), 2))  # after a period at whose beginning, and end, an impulse acted
        x[0, 0], x[1] = T, 1.0
        h = _rows(slope) @ self._answers(x)
        first, last = np.moveaxis(np.abs(h), 2, 0)
        both, same = first + last, h[..., 0] * h[..., 1] >= 0.0
        area = np.where(same, both / 2.0, (first**2 + last**2) / (2.0 * np.where(same, 1.0, both)))
        return np.asarray(T * area.sum(axis=0), float)

    def responses(self, k: int) -> Array:
        """Responses of e, de and u (n, 3) to a unit pulse of input k of `loop`; 0 if it has no such input."""
        if k >= self.loop.B.shape[1]:
            return np.zeros((1, 3))
        return np.vstack([self.loop.D[:, k], self._answers(self.loop.B[:, k : k + 1])[..., 0]])

    def measured_gains(self, slope: float = 0.0, *, rate: bool = False) -> Array:
        """Peak gains (4,) to |e|, |de|, |u|, |de + slope e| from a measurement error of e.

        rate: from a measurement error of de.
        """
        return np.asarray(np.abs(self.responses(1 + rate) @ _rows(slope).T).sum(axis=0), float)

    def _answers(self, x: Array) -> Array:
        """Responses of e, de and u (n, 3, m) at n samples to initial states x (order, m), until decayed."""
        found = []
        for _ in range(self.steps):
            found.append(self.loop.C @ x)
            x = self.loop.A @ x
        return np.array(found)

    @property
    def steps(self) -> int:
        """Number of periods in which an impulse response of a stable loop decays to about 1e-5."""
        slowest = -np.log(max(np.abs(self.poles).max(), 1e-300))
        return min(200_000, int(np.ceil(12.0 / slowest)) + len(self.poles))


def _rows(slope: float) -> Array:
    """Matrix (4, 3) from [e, de, u] to [e, de, u, de + slope e]."""
    return np.vstack([np.eye(3), [slope, 1.0, 0.0]])


def of_each(loops: Sequence[Sampled], figures: Callable[[Sampled], Array]) -> list[Array]:
    """Result of `figures` for each loop, computed once for axes that share a loop."""
    found = {id(loop): figures(loop) for loop in {id(loop): loop for loop in loops}.values()}
    return [found[id(loop)] for loop in loops]


def analyse(axis: Axis, controller: LinearSystem) -> Sampled:
    """Analyse the loop of axis and controller; the controller is a system from [e, de] to u.

    With an observer it has a third input, see `hil.design.stability.observed_loop`. Raises
    ModelError for a controller with another period.
    """
    plant = disturbed_axis(axis)
    loop = _closed(plant, controller)
    found = Sampled(loop.poles(), None, loop)
    if not found.stable:
        return found
    measuring = controller._replace(B=controller.B[:, :2], D=controller.D[:, :2])
    opened = measuring.after(plant._replace(B=plant.B[:, :1], D=plant.D[:, :1]))
    return found._replace(margins=margins(opened))


def _closed(plant: LinearSystem, controller: LinearSystem) -> LinearSystem:
    """Closed loop from disturbance d, noise n, m and observed c to e, de, u; y = [e + n, de + m, c]."""
    A, B, C, _, T = plant
    count = controller.B.shape[1]  # 2, or 3 with an observer
    # Inputs d, n, m, c, u; outputs e, de, u, and y for the controller.
    inputs = np.column_stack([B[:, 1], np.zeros((len(A), count)), B[:, 0]])
    outputs = np.vstack([-C, np.zeros((1, len(A))), -C, np.zeros((count - 2, len(A)))])
    through = np.zeros((3 + count, 2 + count))
    through[2, -1] = 1.0
    through[3:, 1:-1] = np.eye(count)
    return LinearSystem(A, inputs, outputs, through, T).closed_with(controller)
