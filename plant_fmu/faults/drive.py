"""Faults of a leg's drive and wiring."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.signals import LEGS
from plant_fmu.faults.fault import Fault, LegFault, Present


class DriveSilence(LegFault):
    """The drive sends nothing. It still hears."""

    kind: Literal["drive_silence"] = "drive_silence"

    def act(self, present: Present) -> None:
        """Silence it."""
        present.silent[self.leg] = True


class DriveReset(Fault):
    """The drive starts anew at this instant: it is in BOOT, its brake closes, its set-up is forgotten."""

    kind: Literal["drive_reset"] = "drive_reset"
    leg: Annotated[int, Field(ge=0, lt=LEGS)]

    def act(self, present: Present) -> None:
        """Restart it."""
        present.reset[self.leg] = True


class DriveGain(LegFault):
    """The leg's force is this multiple of what its drive means to apply."""

    kind: Literal["drive_gain"] = "drive_gain"
    factor: float

    def act(self, present: Present) -> None:
        """Several factors multiply."""
        present.gain[self.leg] *= self.factor


class DriveSign(LegFault):
    """The leg's force has the wrong sign, as with swapped wires."""

    kind: Literal["drive_sign"] = "drive_sign"

    def act(self, present: Present) -> None:
        """Turn it round."""
        present.gain[self.leg] *= -1.0


class DriveSaturation(LegFault):
    """The drive gives no more force than this."""

    kind: Literal["drive_saturation"] = "drive_saturation"
    limit_N: Annotated[float, Field(ge=0)]

    def act(self, present: Present) -> None:
        """Of several limits the smallest counts."""
        present.saturation_N[self.leg] = min(present.saturation_N[self.leg], self.limit_N)
