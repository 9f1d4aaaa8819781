"""H-infinity for a design: from what is asked of the loop to a controller that gives it, or why none does.

A design and an axis in, controller and figures out; no file.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from drivers.errors import SynthesisError
from hil.config.design import Design, DesignAxis
from hil.design.synthesis.axis import generalised_plant, sampled_problem
from hil.design.synthesis.hinf import Synthesis, hinf
from hil.design.synthesis.multiplicative import Relative, covered
from hil.design.synthesis.norm import norm
from hil.design.synthesis.result import Judgement, described, judge
from hil.design.synthesis.weights import error_weight
from hil.mathematics.linear_system import LinearSystem

RATIOS = tuple(1.0 + 0.01 * k for k in range(1, 11))
"""gamma / gamma_opt, tried in this order."""
CLOSE = 1.01
"""The norm may exceed gamma by this factor: what sampling, hold and the rational delay may cost."""


RAISED = (
    ". The control weight was raised to cover what the measured axes differ by: measure with more force, to "
    "higher frequencies"
)


@contextmanager
def computable() -> Iterator[None]:
    """Refuse numbers at which the algebra inside gives up, or warns: SciPy does near a singular matrix.

    Raises SynthesisError.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    except (np.linalg.LinAlgError, Warning) as error:
        raise SynthesisError(
            f"the numbers of the design are too far apart to compute with ({error}), allowed: weights of one "
            "loop; look for a wrong unit"
        ) from None


class Designed(NamedTuple):
    """A controller that may be used, and all that is known of it."""

    K: LinearSystem
    """Continuous."""
    judged: Judgement
    figures: dict[str, Any]


@computable()
def design_hinf(
    design: Design, axis: DesignAxis, progress: Callable[[str], None], measured: Relative | None = None
) -> Designed:
    """Return the controller of the smallest gamma, within 1.1 of the optimum, that a loop can run.

    measured: what it has to stand beside; the control weight covers it.

    Raises SynthesisError: the weights cannot be met, or no gamma of these gives a usable controller; the
    message says which and what would help.
    """
    asked = design.weights.control
    if measured is not None:
        design = covered(design, measured, axis.gain)
    P, sampled = generalised_plant(design, axis), sampled_problem(design, axis)
    n_y = len(design.inputs)
    reasons: tuple[str, ...] = ()
    for ratio in RATIOS:
        progress(f"gamma at {ratio:.2f} of the optimum")
        found = hinf(P, n_y, 1, ratio)
        if found.gamma > 1.0:
            raised = "" if design.weights.control is asked else RAISED
            _refuse_weights(P.closed_with(found.K), found, reasons, design.inputs, raised)
        judged = judge(design, axis, found.K)
        reasons = judged.reasons
        if reasons:
            continue
        continuous = norm(P.closed_with(found.K)).value
        discrete = norm(sampled.closed_with(judged.sampled)).value
        if max(continuous, discrete) <= CLOSE * found.gamma:
            return Designed(found.K, judged, _figures(design, axis, found, judged, continuous, discrete))
        reason = (
            f"the norm is {continuous:.4g}, of the sampled loop {discrete:.4g}, allowed: {CLOSE:g} gamma, "
            f"{CLOSE * found.gamma:.4g}; delay and hold cost too much, raise delay_order, or ask for less"
        )
        reasons = (reason,)
    raise SynthesisError(f"no controller within 1.1 of the optimum can be used: {'; '.join(reasons)}")


def channels(closed: LinearSystem, inputs: Sequence[str]) -> dict[str, float]:
    """Return the norm of each weighted path of a closed four-block problem, by name."""
    causes = ["disturbance", *(f"noise of {name}" for name in inputs)]
    found = {}
    for i, effect in enumerate(("error", "control")):
        for j, cause in enumerate(causes):
            one = closed._replace(B=closed.B[:, [j]], C=closed.C[[i]], D=closed.D[[i]][:, [j]])
            found[f"{cause} to {effect}"] = norm(one).value
    return found


def _refuse_weights(
    closed: LinearSystem, found: Synthesis, reasons: tuple[str, ...], inputs: Sequence[str], raised: str
) -> None:
    """Say that the weights ask too much, and which of them; raised: what was made of them before."""
    if reasons:
        raise SynthesisError(
            f"gamma below 1 is reached, {found.gamma_opt:.3g} at best, but by no controller that can run: "
            + "; ".join(reasons)
        )
    best = found.gamma_opt if found.gamma_opt >= 1.0 else found.gamma  # the first tried, a hundredth above
    shares = channels(closed, inputs) if closed.is_stable() else {}
    named = ", ".join(f"{name} {share:.3g}" for name, share in shares.items() if share > 0.5) or "all of them"
    raise SynthesisError(
        f"no controller does what the weights ask: gamma is {best:.3g} at best, allowed: below 1. "
        f"Of 1 take: {named}. Allow more error or more control, or state less disturbance, noise or delay"
        f"{raised}"
    )


def floor_at_rest(design: Design) -> float:
    """Return what gamma cannot get below, whatever the controller: |W_e| of the noise of error, at rest.

    A double integrator in a stable loop follows its measurement there: T = 1.
    """
    at_rest = error_weight(design.weights.error).response(np.zeros(1))[0, 0, 0]
    return float(abs(at_rest)) * design.weights.noise.error_m


def _figures(
    design: Design, axis: DesignAxis, found: Synthesis, judged: Judgement, continuous: float, discrete: float
) -> dict[str, Any]:
    return {
        "gamma": found.gamma,
        "gamma_opt": found.gamma_opt,
        "gamma_at_rest": floor_at_rest(design),
        "norm": continuous,
        "norm_sampled": discrete,
        **described(design, axis, judged, found.K),
        "lump_lag": design.lump_lag,
    }
