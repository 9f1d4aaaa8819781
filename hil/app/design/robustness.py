"""Robustness of a designed loop: against measured axes, and against the coupling by a robot's payload."""

from math import isclose
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError, SynthesisError
from hil.app.configuration.configuration import load
from hil.app.stability.subject import Stated, Subject
from hil.config.axis_model import AxisSpace
from hil.config.design import Design, DesignAxis
from hil.config.model import ModelSettings
from hil.design.stability.disturbance import Inertia
from hil.design.synthesis.axis import loop_gain, sampled_axis
from hil.design.synthesis.methods import Designed
from hil.design.synthesis.multiplicative import Margin, Relative, margin

POSES = 25
"""Poses of the reference for each corner of the payload's ranges."""


def couplings(configuration: str, axes: AxisSpace, rate_Hz: float) -> list[Array]:
    """Coupling matrices Gamma (6, 6) of the axes along a reference, at each corner of the payload's ranges.

    Raises ConfigurationError: not a robot, or another loop than the design's.
    """
    c = load(configuration)
    subject = Subject(c, Stated())
    law, rate = c.controller, c.loop.rate_Hz
    for wrong, found, allowed in (
        (subject.on_bench, "plant.model: six uncoupled legs", "a configuration of the robot"),
        (rate != rate_Hz, f"loop.rate_Hz: {rate:g}", f"as in the design, {rate_Hz:g}"),
        (law.axes not in (None, axes), f"controller.law {law.law}: axes {law.axes}", f"the design's, {axes}"),
    ):
        if wrong:
            raise ConfigurationError(f"{c.source}: {found}, allowed: {allowed}")
    path = subject.path[:: max(1, len(subject.path) // POSES)]
    model = c.controller.believed or ModelSettings()
    return [Gamma for robot in subject.linearised(model, axes) for Gamma in robot.at(path).Gamma]


def for_the_robot(
    design: Design, axis: DesignAxis, Gammas: list[Array], *, keep_gain: bool
) -> tuple[Design, DesignAxis]:
    """Design and axis for a robot's range of inertia, from Gammas (6, 6); the axis' gain unless measured."""
    least, largest = Inertia.of(np.array(Gammas)).eigenvalues
    if keep_gain:  # measured gain with the model's payload, and modelled gain
        least, largest = min(least, axis.gain * least), max(largest, axis.gain * largest)
    else:
        gain = least if isclose(least, largest) else 2.0 / (1.0 / least + 1.0 / largest)
        axis = axis.model_copy(update={"gain": gain})
    # gain / (1 + share) to gain / (1 - share) covers least to largest
    share = max(axis.gain / least - 1.0, 1.0 - axis.gain / largest, 0.0)
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
    """Margins of robust stability of the exact sampled loop, as plain values.

    Raises SynthesisError for a loop that is not robustly stable.
    """
    figures: dict[str, Any] = {}
    L = loop_gain(made.judged.sampled, sampled_axis(axis, design.rate_Hz, design.inputs))
    if measured is not None:
        alone = margin(measured, L, design.rate_Hz)
        figures["measured"] = {"norm": alone.norm, "at_rad_s": alone.at_rad_s}
        _refuse(alone, "the measured axes")
    if Gammas:
        scaled = [Gamma / axis.gain for Gamma in Gammas]
        if measured is not None:
            scaled += Gammas  # times the measured gain
        least, largest = Inertia.of(np.array(Gammas)).eigenvalues
        figures["robot"] = {"gamma_eigenvalues": [least, largest]}
        _refuse_unstable(design, axis, made, scaled)
        if measured is not None:
            coupled = margin(measured, L, design.rate_Hz, scaled)
            figures["robot"] |= {"norm": coupled.norm, "at_rad_s": coupled.at_rad_s}
            _refuse(coupled, "the measured axes, coupled by the robot,")
    return figures


def _refuse(left: Margin, what: str) -> None:
    if left.norm >= 1.0:
        raise SynthesisError(
            f"{what} differ from the nominal one by more than the loop tolerates: |W T| is {left.norm:.3g} "
            f"at {left.at_rad_s / (2 * np.pi):.3g} Hz, allowed: below 1 everywhere; reduce the bandwidth, "
            "or measure with more force"
        )


def _refuse_unstable(design: Design, axis: DesignAxis, made: Designed, Gammas: list[Array]) -> None:
    """Refuse a loop unstable at an eigenvalue of Gamma: coupled axes have the poles of single axes."""
    for value in np.unique(np.round(np.linalg.eigvals(np.array(Gammas)).real, 4)):
        legs = sampled_axis(
            axis.model_copy(update={"gain": axis.gain * float(value)}), design.rate_Hz, design.inputs
        )
        if not legs.closed_with(made.judged.sampled).is_stable():
            raise SynthesisError(
                f"the coupled loop is unstable where Gamma has an eigenvalue of {value * axis.gain:.3g}, "
                "allowed: stable along the robot's reference at every corner; use `hil design mu`, or "
                "state smaller ranges"
            )
