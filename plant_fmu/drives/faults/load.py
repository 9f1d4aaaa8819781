"""Unforeseen loads on the platform."""

from plant_fmu.drives.faults.fault import Fault, Present


class WrenchStep(Fault):
    """A wrench on the platform at its origin, base frame."""

    wrench: tuple[float, float, float, float, float, float]
    """N, N m."""

    def act(self, present: Present) -> None:
        """Several wrenches add up."""
        present.wrench += self.wrench
