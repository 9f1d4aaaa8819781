"""Fault: a drive that applies less than its commanded force."""

from __future__ import annotations

from plant_fmu.faults.fault import LegFault, Present


class Derated(LegFault, kind="derated"):
    """The leg's force is this share of the force that its drive would apply."""

    share: float = 0.5

    def act(self, present: Present) -> None:
        """Apply the share; several faults multiply."""
        present.gain[self.leg] *= self.share
