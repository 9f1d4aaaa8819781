"""H-infinity and mu synthesis for a design: a controller, or the reason why none was found.

Input: a design and an axis; output: controller and figures; no files.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from math import inf, pi
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import SynthesisError
from hil.config.design import Design, DesignAxis, UncertaintyRanges
from hil.design.synthesis.axis import generalised_plant, sampled_problem
from hil.design.synthesis.dk import bounds_over_frequency, dk_iteration, fitted_scales, scaled, with_own
from hil.design.synthesis.hinf import Synthesis, hinf
from hil.design.synthesis.multiplicative import CORNER, Relative, covered
from hil.design.synthesis.norm import norm
from hil.design.synthesis.result import SLOW, Judgement, described, judge, reduced
from hil.design.synthesis.structured import structured_plant
from hil.design.synthesis.weights import error_weight, noise
from hil.mathematics.linear_system import LinearSystem

RATIOS = tuple(1.0 + 0.01 * k for k in range(1, 11))
"""Values of gamma / gamma_opt, tried in this order."""
CLOSE = 1.01
"""Factor by which the norm may exceed gamma because of sampling, hold and the rational delay."""


RAISED = (
    ". The control weight was raised to cover the uncertainty of the measured axes: measure with more force "
    "and up to higher frequencies"
)


@contextmanager
def computable() -> Iterator[None]:
    """Context that turns numerical errors and warnings, as near a singular matrix, into SynthesisError."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    except (np.linalg.LinAlgError, Warning) as error:
        raise SynthesisError(
            f"the design is numerically ill-conditioned ({error}); look for a wrong unit in its weights"
        ) from None


class Designed(NamedTuple):
    """A controller that a loop can run, its analysis, and figures for the controller file."""

    K: LinearSystem
    """Continuous controller, from [e, de] to u."""
    judged: Judgement
    figures: dict[str, Any]


@computable()
def design_hinf(
    design: Design, axis: DesignAxis, progress: Callable[[str], None], measured: Relative | None = None
) -> Designed:
    """Design the controller of the smallest gamma, within 1.1 of the optimum, that a loop can run.

    measured: uncertainty of the measured axes, which the control weight then covers.

    Raises SynthesisError if the weights cannot be met, or no gamma gives a usable controller; the message
    states the cause and a remedy.
    """
    stated = design.weights.control
    if measured is not None:
        design = covered(design, measured, axis.gain)
    P, sampled = generalised_plant(design, axis), sampled_problem(design, axis)
    n_y = len(design.inputs)
    reasons: tuple[str, ...] = ()
    for ratio in RATIOS:
        progress(f"gamma at {ratio:.2f} of the optimum")
        found = hinf(P, n_y, 1, ratio)
        if found.gamma > 1.0:
            raised = "" if design.weights.control is stated else RAISED
            _refuse_weights(P.closed_with(found.K), found, reasons, design.inputs, raised)
        judged = judge(design, axis, found.K)
        reasons = judged.reasons
        if reasons:
            continue
        continuous = norm(P.closed_with(found.K))
        discrete = norm(sampled.closed_with(judged.sampled))
        if max(continuous, discrete) <= CLOSE * found.gamma:
            # at rest a double integrator in a stable loop follows its measurement, with every controller
            at_rest = abs(error_weight(design.weights.error).response(np.zeros(1))[0, 0, 0])
            figures = {
                "gamma": found.gamma,
                "gamma_opt": found.gamma_opt,
                "gamma_at_rest": float(at_rest) * design.weights.noise.error_m,
                "norm": continuous,
                "norm_sampled": discrete,
                **described(design, axis, judged, found.K),
                "lump_lag": design.lump_lag,
            }
            return Designed(found.K, judged, figures)
        reason = (
            f"the norm is {continuous:.4g}, of the sampled loop {discrete:.4g}, allowed: {CLOSE:g} gamma, "
            f"{CLOSE * found.gamma:.4g}; raise delay_order, or relax the weights"
        )
        reasons = (reason,)
    raise SynthesisError(f"no controller within 1.1 of the optimum can be used: {'; '.join(reasons)}")


def _refuse_weights(
    closed: LinearSystem, found: Synthesis, reasons: tuple[str, ...], inputs: Sequence[str], raised: str
) -> None:
    """Raise SynthesisError for weights that cannot be met, with the largest norms; raised: added remark."""
    if reasons:
        raise SynthesisError(
            f"gamma is {found.gamma_opt:.3g} at best, below 1 as required, but no such controller can run: "
            + "; ".join(reasons)
        )
    best = found.gamma_opt if found.gamma_opt >= 1.0 else found.gamma  # the first tried, a hundredth above
    causes = ["disturbance", *(f"noise of {name}" for name in inputs)] if closed.is_stable() else []
    shares = []
    for (i, effect), (j, cause) in product(enumerate(("error", "control")), enumerate(causes)):
        path = closed._replace(B=closed.B[:, [j]], C=closed.C[[i]], D=closed.D[[i]][:, [j]])
        shares.append(f"{cause} to {effect} {norm(path):.3g}")
    raise SynthesisError(
        f"no controller meets the weights: gamma is {best:.3g} at best, allowed: below 1. Norms of its "
        f"paths: {', '.join(shares) or 'none'}. Allow more error or more control, or state less disturbance, "
        f"noise or delay{raised}"
    )


POINTS = 80
"""Number of frequencies in the grid of mu, before it is refined around the peak."""
SPAN = 1e-4, 5.0
"""Range of the frequency grid of mu, as shares of the Nyquist frequency."""
NOTHING = 1e-4
"""Hankel singular value, as a share of the largest, below which a controller state is omitted. Such states
come from nearly cancelling poles and zeros of the scales, and an anti-windup would need large gains for them.
"""
LISTED = 40
"""Number of frequencies of mu that the controller file lists."""


@computable()
def design_mu(
    design: Design, axis: DesignAxis, progress: Callable[[str], None], measured: Relative | None = None
) -> Designed:
    """Design the controller of the smallest mu that D-K iteration finds.

    measured: uncertainty of the measured axes, as a separate block.

    Raises SynthesisError if no uncertainty is stated, mu does not fall below 1, or the controller cannot run;
    the message states the cause and a remedy.
    """
    if design.uncertainty is None:
        raise SynthesisError(
            "the design has no section uncertainty, allowed: inertia, transport_ms, drive_bandwidth_Hz; or "
            "use `hil design hinf`"
        )
    if design.lump_lag:
        raise SynthesisError(
            "lump_lag: true, allowed: false, because the lag has its own range; or use `hil design hinf`"
        )
    problem = structured_plant(design, axis, design.uncertainty, measured)
    start = hinf(generalised_plant(design, axis), problem.n_y, 1).K  # of the axis without its uncertainty
    slow = 2.0 * SLOW * judge(design, axis, start).margins.crossover_rad_s
    within = slow, CORNER * pi * design.rate_Hz  # their poles become the controller's and the closed loop's
    grid: Array = np.asarray(np.geomspace(*SPAN, POINTS) * pi * design.rate_Hz)
    found = dk_iteration(problem, start, grid, within, progress)
    K = reduced(found.K, noise(design), NOTHING)
    judged = judge(design, axis, K)
    if judged.reasons:
        raise SynthesisError(
            f"mu is {found.bounds.peak:.4g}, below 1 as required, but the controller cannot run: "
            + "; ".join(judged.reasons)
        )
    M = problem.plant.closed_with(K)
    bounds = bounds_over_frequency(M, problem.blocks, with_own(grid, M))
    scales = fitted_scales(M, bounds, problem.blocks, within)
    proven = norm(scaled(problem, scales).closed_with(K))
    corners = sampled_corners(design, axis, design.uncertainty, judged.sampled)
    if max(proven, corners) >= 1.0:
        raise SynthesisError(
            f"mu is {bounds.peak:.4g}, with its peak at {bounds.peak_rad_s:.3g} rad/s, proven up "
            f"to {proven:.4g} at all frequencies, and the norm of the sampled loop is {corners:.4g} at the "
            "corners of the uncertainty, allowed: all below 1; relax the weights, or raise delay_order"
        )
    omega, upper, n = bounds.omega, bounds.upper.bound, len(problem.blocks) - 1
    response = M.response(omega)
    k = np.unique(np.append(np.linspace(0, len(omega) - 1, LISTED).astype(int), upper.argmax()))
    figures = {
        "mu_proven": proven,
        "norm_sampled_corners": corners,
        "rounds": found.history,
        "states_left_out": found.K.order - K.order,
        "mu_upper": bounds.peak,
        "mu_peak_rad_s": bounds.peak_rad_s,
        "nominal_performance": float(np.linalg.svd(response[:, n:, n:], compute_uv=False).max()),
        **described(design, axis, judged, K),
        "mu": {"omega_rad_s": omega[k].tolist(), "upper": upper[k].tolist()},
        "uncertainty": design.uncertainty.model_dump(mode="json"),
    }
    return Designed(K, judged, figures)


def sampled_corners(design: Design, axis: DesignAxis, ranges: UncertaintyRanges, K: LinearSystem) -> float:
    """Largest norm of the sampled loop over the eight corners of the uncertainty; inf if one is unstable."""
    worst = 0.0
    for share, transport_ms, lag_ms in product(
        (1.0 - ranges.inertia, 1.0 + ranges.inertia), ranges.transport_ms, ranges.lag_ms
    ):
        update = {"gain": axis.gain / share, "transport_ms": transport_ms, "lag_ms": lag_ms}
        problem = sampled_problem(design, axis.model_copy(update=update))
        # the first input is d, which accelerates a lighter body more, too
        B, D = problem.B.copy(), problem.D.copy()
        B[:, 0], D[:, 0] = B[:, 0] / share, D[:, 0] / share
        loop = problem._replace(B=B, D=D).closed_with(K)
        worst = max(worst, norm(loop) if loop.is_stable() else inf)
    return worst
