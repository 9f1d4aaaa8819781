"""Faults of a leg's drive, wiring and brake."""

from plant_fmu.drives.faults.fault import LegFault, Present


class LegGain(LegFault):
    """The leg's force is this multiple of what its drive means to apply; -1 is swapped wires."""

    gain: float = -1.0

    def act(self, present: Present) -> None:
        """Several gains multiply."""
        present.gain[self.leg] *= self.gain


class Silence(LegFault):
    """The drive sends nothing. It still hears."""

    def act(self, present: Present) -> None:
        """Silence it."""
        present.silent[self.leg] = True


class StuckBrake(LegFault):
    """The brake stays engaged or released, whatever the drive wants."""

    engaged: bool = True

    def act(self, present: Present) -> None:
        """Hold the brake; of several faults the last one counts."""
        present.stuck[self.leg] = self.engaged
