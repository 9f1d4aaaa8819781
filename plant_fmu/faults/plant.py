"""Faults of the plant behind the drives."""

from typing import Literal

from plant_fmu.faults.fault import Fault, LastingFault, Present


class PlantNaN(LastingFault):
    """The plant's lengths are not numbers."""

    kind: Literal["plant_nan"] = "plant_nan"

    def act(self, present: Present) -> None:
        """Spoil the lengths."""
        present.not_finite = True


class PlantHang(LastingFault):
    """The plant does not come back from a step: no drive answers; what it has missed it catches up with."""

    kind: Literal["plant_hang"] = "plant_hang"

    def act(self, present: Present) -> None:
        """Let it hang."""
        present.hangs = True


class PlantCrash(Fault):
    """The plant fails at this instant, and its drives with it."""

    kind: Literal["plant_crash"] = "plant_crash"

    def act(self, present: Present) -> None:
        """Let it fail."""
        present.crashes = True
