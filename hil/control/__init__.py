"""Control laws: one per file, one row in LAWS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hil.config import ControllerSettings, LegSpin
from hil.control.inverse_dynamics import JointInverseDynamics
from hil.control.law import Law
from hil.control.pd import JointPD
from hil.geometry import Platform

LAWS: dict[str, Callable[[Any, Platform, LegSpin], Law]] = {
    "pd": JointPD.build,
    "inverse_dynamics": JointInverseDynamics.build,
}
"""`controller.law` of the configuration -> builder(settings, platform, leg_spin)."""


def build_law(settings: ControllerSettings, platform: Platform, leg_spin: LegSpin) -> Law:
    """Return the law that the configuration names."""
    return LAWS[settings.law](settings, platform, leg_spin)


__all__ = ["LAWS", "Law", "build_law"]
