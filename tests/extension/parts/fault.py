"""A drive that gives less than it should."""

from __future__ import annotations

from plant_fmu.faults.fault import LegFault, Present


class Derated(LegFault, kind="derated"):
    """The leg's force is this share of what its drive means to apply."""

    share: float = 0.5

    def act(self, present: Present) -> None:
        """Several shares multiply."""
        present.gain[self.leg] *= self.share
