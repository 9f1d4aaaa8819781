"""Fits gain, delay and lag in front of a double integrator to measured responses, and bounds the error."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from drivers.arrays import Array, ComplexArray, Flags
from drivers.errors import IdentificationError
from hil.design.stability.sampled_loop import sampled_axis
from hil.lab.identify.estimators.response import Response
from hil.mathematics.linear_system import lag


def axis_response(frequency_Hz: Array, period_s: float, transport_s: float, lag_s: float) -> ComplexArray:
    """Response (n,) s^2 of exp(-transport s) / (lag s + 1) / s^2 after a hold of a period, exact at samples.

    Far below the rate it is (1 - exp(-s T)) / (s T) times that: at 30 Hz and 1 kHz within 0.001 %.
    """
    axis = sampled_axis(transport_s, lag(lag_s if lag_s > 1e-9 * period_s else 0.0), period_s)
    return axis.response(2.0 * np.pi * np.asarray(frequency_Hz, float))[:, 0, 0]


COHERENT = 0.9
FEWEST_LINES = 6
"""Least number of coherent lines of each axis."""
SYSTEMATIC = 2e-3
"""Least relative error of a spectral line; errors from coupling and changing pose do not average out."""
LONGEST_PERIODS = 20.0
SURE_S = 2e-4
"""Largest standard deviation, s, of a reported delay."""
SEPARATED = 10.0
"""Largest condition number of the directions of six lines for a coupling matrix."""


class Delays(NamedTuple):
    """Delays from measurement to force, s, with standard deviations.

    If transport delay and lag cannot be separated, lag is exactly 0 and transport is their sum.
    """

    transport_s: float
    transport_std_s: float
    lag_s: float
    lag_std_s: float
    total_s: float
    """Transport, lag and half a period of hold: slope of the phase at low frequency."""
    total_std_s: float


class Fit(NamedTuple):
    """Axis model gain exp(-transport s) / (lag s + 1) / s^2 fitted to responses; standard deviations."""

    gain: Array
    """(6,)."""
    gain_std: Array
    delays: Delays
    used: Flags
    """(lines, 6): lines used in the fit, excited and coherent."""


class Uncertainty(NamedTuple):
    """Upper bound, with 95 % confidence, of the relative error of the fitted axis model over frequency."""

    frequency_Hz: Array
    bound: Array
    coupled: bool
    """True if the bound covers the coupling of the axes: everywhere six neighbouring lines moved them in six
    independent directions.
    """


def fit_axes(response: Response) -> Fit:
    """Fit gain, delay and lag of the axis model; each spectral line is weighted by its certainty.

    The loss is soft: a model error in weight or friction distorts only the lowest lines, which have the least
    noise. It belongs to the bound, not to the gain.

    Raises IdentificationError: too few coherent lines on an axis, responses unlike the axis model, or an
    excitation that does not show the delay.
    """
    used = response.excited & (response.coherence >= COHERENT) & np.isfinite(response.G)
    for axis, lines in enumerate(used.sum(axis=0).tolist()):
        if lines < FEWEST_LINES:
            there = int(response.excited[:, axis].sum())
            raise IdentificationError(
                f"axis {axis} is coherent with its reference (above {COHERENT:g}) at {lines} of {there} "
                f"excited lines, allowed: at least {FEWEST_LINES}; excite it more (--force), longer "
                "(--duration), or over more frequencies; `hil identify CONFIG` excites every axis"
            )
    T = response.period_s
    line, of = np.nonzero(used)
    f, G = response.frequency_Hz[line], response.G[used]
    weight = 1.0 / np.hypot(response.std[used], SYSTEMATIC)

    def residual(x: Array) -> Array:
        P = x[of] * axis_response(f, T, x[6] * T, x[7] * T)
        error = weight * (G / P - 1.0)
        return np.concatenate([error.real, error.imag])

    def search(*starts: tuple[float, ...]) -> tuple[Array, Array, Array]:
        """Best fit over start delays: parameters (8,), residual, and covariance."""
        n = len(starts[0])
        fits = [
            least_squares(
                lambda x: residual(np.append(x, 0.0)),
                [1.0] * 6 + [*start],
                bounds=([1e-3] * 6 + [0.0] * n, [1e3] * 6 + [LONGEST_PERIODS] * n),
                loss="soft_l1",
                xtol=1e-10,
                max_nfev=60,
            )
            for start in starts
        ]
        best = min(fits, key=lambda fit: float(fit.cost))
        # Scaled by the residual, so that a systematic misfit counts; a parameter at its bound has no slope.
        scale = max(1.0, 2.0 * float(best.cost) / (2 * len(f) - 8))
        C = scale * np.linalg.pinv(best.jac.T @ best.jac)
        return np.append(best.x, 0.0)[:8], best.fun, np.pad(C, (0, 2 - n))

    x, error, C = search((0.5, 0.5), (2.0, 0.5), (1.0, 3.0))
    worst = float(np.median(np.abs(error[: len(f)] + 1j * error[len(f) :]) / weight))
    if worst > 0.5:
        raise IdentificationError(
            f"the measured responses are {100 * worst:.0f} % from any gain, delay and lag in front of a "
            "double integrator, allowed: 50 %; the model is of another robot, or the law does not linearise "
            "the axes"
        )
    if T * np.sqrt(C.diagonal()[6:].max()) > SURE_S:
        x, _, C = search((0.5,), (2.0,), (4.0,))
    std = np.sqrt(np.diag(C))
    both = T * float(np.sqrt(max(C[6:, 6:].sum(), 0.0)))
    if not both <= SURE_S:
        raise IdentificationError(
            f"the delay is known to {1e3 * both:.2g} ms, allowed: {1e3 * SURE_S:g} ms; coherent lines end "
            f"at {f.max():.3g} Hz, where noise hides so small a phase: excite higher frequencies, more "
            "(--force) or longer (--duration)"
        )
    transport, lag = (T * x[6:]).tolist()
    total = transport + lag + 0.5 * T
    delays = Delays(transport, float(std[6]) * T, lag, float(std[7]) * T, total, both)
    return Fit(np.asarray(x[:6], np.float64), std[:6], delays, used)


def uncertainty(response: Response, fit: Fit) -> Uncertainty:
    """Upper bound over frequency of the relative error between measured axes and the fitted model.

    For a single axis it is the relative error plus the radius of its 95 % circle. An excited line that is not
    coherent counts with a large circle. Six neighbouring lines that move the axes in six directions also
    determine the coupling, the full matrix Delta in Y = P0 (1 + Delta) V. Six equal controllers must tolerate
    its largest singular value (K. Zhou and J. C. Doyle, Essentials of Robust Control, Prentice Hall, 1998,
    ch. 8). This value is convex in Delta, so noise only raises its mean.

    The bound extends from the first to the last coherent line, each value over six neighbouring lines. If an
    axis has no line among the six, there is no bound.

    Raises IdentificationError: all six axes can be bounded at fewer than two lines.
    """
    measured = response.excited & np.isfinite(response.G) & np.isfinite(response.radius)
    coherent = np.flatnonzero(fit.used.any(axis=1))
    lines = np.flatnonzero(measured.any(axis=1))
    lines = lines[(lines >= coherent[0]) & (lines <= coherent[-1])]
    f = response.frequency_Hz[lines]
    found = fit.delays
    P0 = axis_response(f, response.period_s, found.transport_s, found.lag_s)[:, None] * fit.gain
    own = measured[lines]
    error = np.where(own, np.abs(response.G[lines] / P0 - 1.0), 0.0)
    circle = np.where(own, response.radius[lines] * np.abs(response.G[lines] / P0), 0.0)
    alone = (error + circle).max(axis=1)
    V = response.V[lines]
    D = response.Y[lines] / P0 - V
    bound, coupled = np.full(len(lines), np.nan), True
    for k in range(len(lines)):
        first = min(max(k - 2, 0), max(len(lines) - 6, 0))
        six = slice(first, first + 6)
        if not own[six].any(axis=0).all():
            continue
        sigma = _largest_singular_value(D[six], V[six])
        coupled = coupled and sigma is not None
        bound[k] = max(sigma or 0.0, float(alone[six].max()))
    bounded = np.isfinite(bound)
    if bounded.sum() < 2:
        raise IdentificationError(
            f"the axes are excited at frequencies too far apart: six neighbouring lines cover all axes at "
            f"{bounded.sum()} lines, allowed: at least 2; give each axis lines in the same band"
        )
    return Uncertainty(f[bounded], bound[bounded], coupled)


def _largest_singular_value(D: ComplexArray, V: ComplexArray) -> float | None:
    """Largest singular value of Delta in D = Delta V, six lines as rows; None if V is near singular."""
    size = np.linalg.norm(V, axis=1)
    if len(V) < 6 or not (size > 0.0).all():
        return None
    V, D = V / size[:, None], D / size[:, None]
    if np.linalg.cond(V) > SEPARATED:
        return None
    return float(np.linalg.svd(np.linalg.solve(V, D), compute_uv=False)[0])
