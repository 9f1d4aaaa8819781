"""Faults of a leg's brake. The drive does not know of them."""

from typing import Annotated, Literal

from pydantic import Field

from plant_fmu.faults.fault import LegFault, Present


class BrakeStuckOpen(LegFault):
    """The brake is released, whatever the drive wants."""

    kind: Literal["brake_stuck_open"] = "brake_stuck_open"

    def act(self, present: Present) -> None:
        """Release the brake; of several faults the last one counts."""
        present.stuck[self.leg] = False


class BrakeStuckClosed(LegFault):
    """The brake is engaged, whatever the drive wants."""

    kind: Literal["brake_stuck_closed"] = "brake_stuck_closed"

    def act(self, present: Present) -> None:
        """Engage the brake; of several faults the last one counts."""
        present.stuck[self.leg] = True


class BrakeSlow(LegFault):
    """The brake opens and closes this much later than its drive counts."""

    kind: Literal["brake_slow"] = "brake_slow"
    by_ms: Annotated[float, Field(gt=0, le=10_000)]

    def act(self, present: Present) -> None:
        """Several delays add up."""
        present.slow_ns[self.leg] += round(self.by_ms * 1e6)


class BrakeSlipping(LegFault):
    """The engaged brake holds only this share of its force."""

    kind: Literal["brake_slipping"] = "brake_slipping"
    share: Annotated[float, Field(ge=0, le=1)]

    def act(self, present: Present) -> None:
        """Several shares multiply."""
        present.share[self.leg] *= self.share


BRAKES = (BrakeStuckOpen, BrakeStuckClosed, BrakeSlipping)
"""What is of the plant's brake alone."""
