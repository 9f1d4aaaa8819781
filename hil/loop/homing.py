"""Homing: finds the motor turns that drives lose at power-off, from the parked leg lengths.

No state, no clock. Such a drive reports length + k step with an unknown whole number k. A leg with a closed
brake has not moved; so k is the number that brings the reading nearest to the parked length. The remaining
difference must be small; otherwise the leg has moved, or the drive was replaced.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS
from drivers.tick_columns import Record

SILENT_TICKS = 20
"""A drive that was silent for longer may have been switched off."""


LOST, MOVED, ENDS = 1, 2, 3
"""Problems of a leg: its turn is unknown; it is not where it was parked; its drive was switched on where its
position field does not cover the whole stroke."""
HOMING = np.dtype(
    [
        ("decode", "<i8"), ("codec", "<i8"),  # the family's decoder, and what it works on
        ("period_s", "<f8"), ("step_m", "<f8", (LEGS,)), ("limit_m", "<f8", (LEGS,)),
        ("shortest", "<f8"), ("longest", "<f8"),  # m, of the stroke
        ("low", "<f8", (LEGS,)), ("high", "<f8", (LEGS,)),  # m, of the position field
        ("braked", "<i8"),  # 1: the brakes are proven shut since they were last open, or were not open
        ("opened", "<i8"),  # 1: the brakes have been open
        ("added", "<f8", (LEGS,)), ("raw", "<f8", (LEGS,)),
        ("there", "<f8", (LEGS,)),  # m, where each leg was last known
        ("known", "<i8", (LEGS,)), ("lost", "<i8", (LEGS,)),
        ("wrong", "<i8", (LEGS,)),  # LOST, MOVED or ENDS
    ]
)  # fmt: skip
"""Record that `Homing` shares with the decoder around the family's own."""


class LastPose(NamedTuple):
    """Leg lengths at which the brakes were closed, and how drives lose turns. Arrays (6,), leg order."""

    length: Array
    """Parked leg lengths, (6,) m."""
    limit_m: Array
    """Largest allowed distance of a leg from its parked length, (6,) m."""
    step_m: Array
    """Leg length, (6,) m, > 0, of which a drive loses whole multiples at power-off."""
    m_per_turn: Array
    """Leg length per motor turn, (6,) m, with its sign."""
    origin: str
    """Source and date of the parked lengths, as text."""
    command: str
    """Command line that sets a leg's parked length."""


class Stroke(NamedTuple):
    """Mechanical range of a leg's length and range that its drive can report, m."""

    shortest: float
    longest: float
    reported: tuple[Array, Array] | None
    """Ends (6,) of the position field of a drive that was switched on at its zero; None: no such limit."""


class Homing:
    """The motor turns that the drives have lost; `hil.loop.homing_kernels.decode` adds them to each length.

    A drive has been switched off if it was silent for long, or if its reading jumps by half a step or more.
    Its number of turns is then found again, from the last known length. If its brake was open, the leg may
    have moved any distance meanwhile, and the number is lost.

    Mutable state, in its record: lengths as the drives report them, the added lengths, the last known length
    of each leg, which turns are known or lost, and problems.
    """

    def __init__(self, pose: LastPose | None, stroke: Stroke, period_s: float) -> None:
        """pose: the parked lengths; None: the drives lose no turns at power-off."""
        self._pose = pose
        self.record: Record = np.zeros((), HOMING)
        self.record["period_s"] = period_s
        self.record["shortest"], self.record["longest"] = stroke[:2]
        self.record["low"], self.record["high"] = stroke.reported or (-np.inf, np.inf)
        if pose is not None:
            self.record["step_m"], self.record["limit_m"] = pose.step_m, pose.limit_m
        self.added, self.raw = self.record["added"], self.record["raw"]
        """(6,) m each: added whole multiples of the step; lengths as the drives report them."""
        self.reset()

    def reset(self) -> None:
        """Restore the state before the first tick."""
        for name in ("added", "raw", "known", "lost", "wrong", "opened"):
            self.record[name] = 0
        self.record["there"] = 0.0 if self._pose is None else self._pose.length

    @property
    def refusal(self) -> str:
        """Reason why the platform must not move; empty if all reporting legs are at their parked lengths."""
        wrong = "; ".join(
            self._wrong(leg, why) for leg, why in enumerate(self.record["wrong"].tolist()) if why
        )
        if self._pose is None or not wrong:
            return ""
        return (
            f"{wrong}. On a closed brake a motor cannot turn: check whether the leg has moved, its brake "
            "slips or its drive was replaced. Measure the leg, accurate to a quarter of the length that its "
            f"drive loses at power-off, and set its length with `{self._pose.command} --leg LEG LENGTH`"
        )

    @property
    def opened(self) -> bool:
        """True once the brakes have been open."""
        return bool(self.record["opened"])

    @property
    def known(self) -> bool:
        """True while the number of lost turns of all six motors is known."""
        return self._pose is None or bool(self.record["known"].all() and not self.record["wrong"].any())

    def _wrong(self, leg: int, why: int) -> str:
        assert self._pose is not None
        if why == LOST:
            return (
                f"leg {leg}: its drive was switched off, or silent for {SILENT_TICKS} ticks, while its brake "
                "was open, so the leg may have moved any distance"
            )
        low, high, there, added, raw = (
            float(self.record[name][leg]) for name in ("low", "high", "there", "added", "raw")
        )
        if why == ENDS:
            return (
                f"leg {leg}: its drive was switched on where its position field covers leg lengths of "
                f"{low + added:.4f} to {high + added:.4f} m, and the stroke is {self.record['shortest']:g} "
                f"to {self.record['longest']:g} m; switch it on with the leg nearer to mid-stroke"
            )
        off, turns = raw + added - there, (there - raw - added) / float(self._pose.m_per_turn[leg])
        return (
            f"leg {leg} is {raw + added:.6f} m long, and was {there:.6f} m ({self._pose.origin}): "
            f"{1e3 * off:+.3f} mm, allowed: {1e3 * self._pose.limit_m[leg]:g} mm (drives.homing); "
            f"{turns:+.3f} turns of its motor would correct it"
        )


def unwrapped_turns(homing: Homing, pose: LastPose) -> Sequence[float]:
    """Number of motor turns, in leg order, that is added to the reading of each drive."""
    return [round(float(turns), 6) + 0.0 for turns in np.divide(homing.added, pose.m_per_turn)]  # -0 is 0
