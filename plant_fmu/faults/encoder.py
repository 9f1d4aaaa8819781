"""Faults of a leg's encoder."""

from typing import Annotated, Literal

from pydantic import Field

from plant_fmu.faults.fault import LegFault, Present


class EncoderJump(LegFault):
    """The encoder slips: from now on it reads this much more than the length."""

    kind: Literal["encoder_jump"] = "encoder_jump"
    by_m: float

    def act(self, present: Present) -> None:
        """Several slips add up."""
        present.offset_m[self.leg] += self.by_m


class EncoderFreeze(LegFault):
    """The encoder keeps the length of the moment the fault begins, at rate zero."""

    kind: Literal["encoder_freeze"] = "encoder_freeze"

    def act(self, present: Present) -> None:
        """Freeze it."""
        present.frozen[self.leg] = True


class EncoderDrift(LegFault):
    """The encoder creeps away: its length at this rate, which its rate contains."""

    kind: Literal["encoder_drift"] = "encoder_drift"
    by_m_s: float

    def act(self, present: Present) -> None:
        """Several drifts add up."""
        present.drifts.append((self.leg, self.by_m_s, present.since_ns))


class EncoderNoise(LegFault):
    """White noise on the length that is sent."""

    kind: Literal["encoder_noise"] = "encoder_noise"
    sigma_m: Annotated[float, Field(ge=0)]
    """Standard deviation."""
    seed: Annotated[int, Field(ge=0)] = 0

    def act(self, present: Present) -> None:
        """Several noises add up."""
        present.noise.append((self.leg, self.sigma_m, present.generator))


class EncoderLate(LegFault):
    """What is sent is the length and rate of so long ago; at first it stands still for as long."""

    kind: Literal["encoder_late"] = "encoder_late"
    by_ms: Annotated[float, Field(gt=0, le=1000)] = 1.0

    def act(self, present: Present) -> None:
        """Several delays add up."""
        present.late_ns[self.leg] += round(self.by_ms * 1e6)


class EncoderScale(LegFault):
    """The encoder counts this multiple of the motion since the fault began; its rate is scaled as well."""

    kind: Literal["encoder_scale"] = "encoder_scale"
    factor: float

    def act(self, present: Present) -> None:
        """Several factors multiply."""
        present.scales.append((self.leg, self.factor, present.since_ns))


class EncoderSign(LegFault):
    """The encoder counts backwards from where it is when the fault begins."""

    kind: Literal["encoder_sign"] = "encoder_sign"

    def act(self, present: Present) -> None:
        """Turn it round."""
        present.scales.append((self.leg, -1.0, present.since_ns))


class EncoderLost(LegFault):
    """The drive knows that its encoder is lost: it says so in its feedback, and still obeys."""

    kind: Literal["encoder_lost"] = "encoder_lost"

    def act(self, present: Present) -> None:
        """Lose it."""
        present.lost[self.leg] = True
