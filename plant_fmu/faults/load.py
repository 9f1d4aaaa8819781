"""Unforeseen loads on the platform."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from plant_fmu.faults.fault import LastingFault, Present

Vector = tuple[float, float, float]


class WrenchStep(LastingFault):
    """A wrench on the platform at its origin, base frame."""

    kind: Literal["wrench_step"] = "wrench_step"
    force_N: Vector = (0.0, 0.0, 0.0)
    moment_N_m: Vector = (0.0, 0.0, 0.0)

    def act(self, present: Present) -> None:
        """Several wrenches add up."""
        present.wrench += (*self.force_N, *self.moment_N_m)


class PayloadStep(LastingFault):
    """The weight of a mass on the platform; its inertia is not emulated."""

    kind: Literal["payload_step"] = "payload_step"
    mass_kg: Annotated[float, Field(gt=0)]
    position_m: Vector = (0.0, 0.0, 0.0)
    """Where the mass lies, platform frame."""

    def act(self, present: Present) -> None:
        """Several masses add up."""
        present.masses.append((self.mass_kg, np.array(self.position_m)))


LOADS = (WrenchStep, PayloadStep)
"""What needs a platform."""
