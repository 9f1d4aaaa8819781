"""Motors that forget their turns at power-off: which turn they are in, from where the legs were parked.

Pure. A drive that forgets reads length + k step with an unknown whole number k. A leg whose brake was closed
is where it was; so k is the number that brings the reading nearest to the length at which it was parked. What
is left of the difference must be small, else the leg has moved, or the drive is another one.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS
from drivers.tick_columns import Record

SILENT_TICKS = 20
"""A drive that was silent for so long may have been switched off."""


LOST, MOVED, ENDS = 1, 2, 3
"""What is wrong with a leg: nobody knows its turn; it is not where it was left; its drive was switched on
where it cannot report all of the stroke."""
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
"""What `Homing` and the decoder around the family's have in common."""


class LastPose(NamedTuple):
    """Where the legs stood with their brakes closed. Arrays are (6,), leg order."""

    length: Array
    """m."""
    limit_m: Array
    """How far a leg may be found from there."""
    step_m: Array
    """Leg length, > 0, of which a drive forgets whole multiples."""
    m_per_turn: Array
    """Leg length a turn of the motor, with its sign."""
    origin: str
    """How that is known, and since when."""
    command: str
    """By which a leg's length can be said."""


class Stroke(NamedTuple):
    """What a leg can be and what its drive can report, m."""

    shortest: float
    longest: float
    reported: tuple[Array, Array] | None
    """Ends (6,) of the position field where the drive was switched on at its zero; None: it has none."""


class Homing:
    """The turns that the drives have forgotten; `hil.loop.homing_kernels.decode` adds them to each length.

    A drive that was silent for long, or whose reading leaps by half a step and more, has been switched off:
    its turn is found again, from where the leg was last seen. With its brake open nobody knows how far it
    went meanwhile, and its turn is lost.

    Mutable state, in its record: lengths as the drives report them, what is added, where each leg was last
    known, which turns are known or lost, what is wrong.
    """

    def __init__(self, pose: LastPose | None, stroke: Stroke, period_s: float) -> None:
        """Take where the legs stood; None: the drives forget nothing."""
        self._pose = pose
        self.record: Record = np.zeros((), HOMING)
        self.record["period_s"] = period_s
        self.record["shortest"], self.record["longest"] = stroke[:2]
        self.record["low"], self.record["high"] = stroke.reported or (-np.inf, np.inf)
        if pose is not None:
            self.record["step_m"], self.record["limit_m"] = pose.step_m, pose.limit_m
        self.added, self.raw = self.record["added"], self.record["raw"]
        """(6,) m each: whole multiples of the step; lengths as the drives report them."""
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick."""
        for name in ("added", "raw", "known", "lost", "wrong", "opened"):
            self.record[name] = 0
        self.record["there"] = 0.0 if self._pose is None else self._pose.length

    @property
    def refusal(self) -> str:
        """Why the platform must not move; empty where every leg that was heard is where it was left."""
        wrong = "; ".join(
            self._wrong(leg, why) for leg, why in enumerate(self.record["wrong"].tolist()) if why
        )
        if self._pose is None or not wrong:
            return ""
        return (
            f"{wrong}. A closed brake lets a leg make no turn: see whether it has moved, its brake slips or "
            "its drive is another one; measure it, and say its length, to a quarter of what its drive "
            "forgets, with "
            f"`{self._pose.command} --leg LEG LENGTH`"
        )

    @property
    def opened(self) -> bool:
        """Whether the brakes have been open."""
        return bool(self.record["opened"])

    @property
    def known(self) -> bool:
        """Whether the turns of all six legs are known."""
        return self._pose is None or bool(self.record["known"].all() and not self.record["wrong"].any())

    def _wrong(self, leg: int, why: int) -> str:
        assert self._pose is not None
        if why == LOST:
            return (
                f"leg {leg}: its drive was switched off, or silent for {SILENT_TICKS} ticks, while its brake "
                "was open, so nobody knows how far the leg went"
            )
        low, high, there, added, raw = (
            float(self.record[name][leg]) for name in ("low", "high", "there", "added", "raw")
        )
        if why == ENDS:
            return (
                f"leg {leg}: its drive was switched on where its position ends at leg lengths of "
                f"{low + added:.4f} and {high + added:.4f} m, allowed: {self.record['shortest']:g} to "
                f"{self.record['longest']:g} m within them; switch it on with the leg nearer to mid-stroke"
            )
        off, turns = raw + added - there, (there - raw - added) / float(self._pose.m_per_turn[leg])
        return (
            f"leg {leg} is {raw + added:.6f} m long, and was {there:.6f} m ({self._pose.origin}): "
            f"{1e3 * off:+.3f} mm, allowed: {1e3 * self._pose.limit_m[leg]:g} mm (drives.homing); "
            f"{turns:+.3f} turns of its motor would mend it"
        )


def unwrapped_turns(homing: Homing, pose: LastPose) -> Sequence[float]:
    """Return how many turns of each motor are added to what its drive reports."""
    return [round(float(turns), 6) + 0.0 for turns in np.divide(homing.added, pose.m_per_turn)]  # -0 is 0
