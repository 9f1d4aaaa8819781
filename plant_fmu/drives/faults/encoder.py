"""Faults of a leg's encoder."""

from plant_fmu.drives.faults.fault import LegFault, Present


class EncoderOffset(LegFault):
    """The encoder slips: it reads this much more than the length."""

    offset_m: float

    def act(self, present: Present) -> None:
        """Several slips add up."""
        present.offset_m[self.leg] += self.offset_m


class EncoderFreeze(LegFault):
    """The encoder keeps the length of the moment the fault begins, at rate zero."""

    def act(self, present: Present) -> None:
        """Freeze it."""
        present.frozen[self.leg] = True


class EncoderLost(LegFault):
    """The drive knows that its encoder is lost: it says so in its feedback, and still obeys."""

    def act(self, present: Present) -> None:
        """Lose it."""
        present.lost[self.leg] = True
