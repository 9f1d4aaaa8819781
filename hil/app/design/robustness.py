"""What a designed loop stands: axes as they were measured, and coupled as a robot's payload couples them."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.errors import SynthesisError
from hil.app.design.robot import eigenvalues, middle, share_of_inertia
from hil.config.design import Design, DesignAxis
from hil.design.synthesis.hinf_design import Designed
from hil.design.synthesis.multiplicative import Margin, Relative, single, together
from hil.design.synthesis.sampled import loop_gain, sampled_axis


def for_the_robot(
    design: Design, axis: DesignAxis, Gammas: list[Array], *, keep_gain: bool
) -> tuple[Design, DesignAxis]:
    """Return design and axis with the inertia of a robot: the middle gain unless measured, and its range."""
    least, largest = eigenvalues(Gammas)
    if keep_gain:  # what was measured with the model's payload, and what the model says
        least, largest = min(least, axis.gain * least), max(largest, axis.gain * largest)
    else:
        axis = axis.model_copy(update={"gain": middle(least, largest)})
    share = share_of_inertia(axis.gain, least, largest)
    if share >= 1.0:
        raise SynthesisError(
            f"the robot's Gamma has eigenvalues {least:.3g} to {largest:.3g}, allowed: above half the axis' "
            f"gain, {axis.gain:.3g}; state smaller ranges of the payload"
        )
    ranges = design.uncertainty
    if ranges is not None and share > ranges.inertia:
        ranges = ranges.model_copy(update={"inertia": share})
    return design.model_copy(update={"uncertainty": ranges}), axis


def robustness(
    design: Design, axis: DesignAxis, made: Designed, measured: Relative | None, Gammas: list[Array]
) -> dict[str, Any]:
    """Return what is left of robust stability on the exact sampled loop.

    Raises SynthesisError where nothing is.
    """
    figures: dict[str, Any] = {}
    L = loop_gain(made.judged.sampled, sampled_axis(axis, design.rate_Hz, design.inputs))
    if measured is not None:
        alone = single(measured, L, design.rate_Hz)
        figures["measured"] = {"norm": alone.norm, "at_rad_s": alone.at_rad_s}
        _refuse(alone, "the measured axes")
    if Gammas:
        scaled = [Gamma / axis.gain for Gamma in Gammas]
        if measured is not None:
            scaled += Gammas  # times the gain that was measured
        least, largest = eigenvalues(Gammas)
        figures["robot"] = {"gamma_eigenvalues": [least, largest]}
        _refuse_unstable(design, axis, made, scaled)
        if measured is not None:
            coupled = together(measured, L, scaled, design.rate_Hz)
            figures["robot"] |= {"norm": coupled.norm, "at_rad_s": coupled.at_rad_s}
            _refuse(coupled, "the measured axes, coupled by the robot,")
    return figures


def _refuse(margin: Margin, what: str) -> None:
    if margin.norm >= 1.0:
        raise SynthesisError(
            f"{what} differ from the nominal one by more than the loop stands: |W T| is {margin.norm:.3g} at "
            f"{margin.at_rad_s / (2 * np.pi):.3g} Hz, allowed: below 1 everywhere; ask for less bandwidth, "
            "or measure with more force"
        )


def _refuse_unstable(design: Design, axis: DesignAxis, made: Designed, Gammas: list[Array]) -> None:
    """Refuse a loop unstable at an eigenvalue of Gamma: coupled axes have the poles of single ones."""
    for value in np.unique(np.round(np.linalg.eigvals(np.array(Gammas)).real, 4)):
        legs = sampled_axis(
            axis.model_copy(update={"gain": axis.gain * float(value)}), design.rate_Hz, design.inputs
        )
        if not legs.closed_with(made.judged.sampled).is_stable():
            raise SynthesisError(
                f"the coupled loop is unstable where Gamma has an eigenvalue of {value * axis.gain:.3g}, "
                "allowed: stable along the robot's reference at every corner; take `hil design mu`, or "
                "state smaller ranges"
            )
