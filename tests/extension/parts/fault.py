"""A drive that gives less than it should."""

from __future__ import annotations

from typing import Literal

from plant_fmu.faults.fault import LegFault, Present


class Derated(LegFault):
    """The leg's force is this share of what its drive means to apply."""

    kind: Literal["derated"] = "derated"
    share: float = 0.5

    def act(self, present: Present) -> None:
        """Several shares multiply."""
        present.gain[self.leg] *= self.share
