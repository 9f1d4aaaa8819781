"""Motors that forget their turns at power-off: which turn they are in, from where the legs were parked.

Pure. A drive that forgets reads length + k step with an unknown whole number k. A leg whose brake was closed
is where it was; so k is the number that brings the reading nearest to the length at which it was parked. What
is left of the difference must be small, else the leg has moved, or the drive is another one.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import ZERO6, Array
from drivers.compiled.compiler import helper
from drivers.signals import LEGS
from drivers.tick_columns import Record

SILENT_TICKS = 20
"""A drive that was silent for so long may have been switched off."""


HOMING = np.dtype(
    [
        ("decode", "<i8"), ("codec", "<i8"),  # the family's decoder, and what it works on
        ("correct", "<i8"),  # correct(tick): `Homing.correct`, where there is something to decide
        ("period_s", "<f8"), ("step_m", "<f8", (LEGS,)),
        ("braked", "<i8"),  # 1: the brakes are proven shut since they were last open, or were not open
        ("opened", "<i8"),  # 1: the brakes have been open
        ("added", "<f8", (LEGS,)), ("raw", "<f8", (LEGS,)),
        ("known", "<i8", (LEGS,)), ("lost", "<i8", (LEGS,)),
        ("wrong", "<i8", (LEGS,)),  # 1: something disagrees
    ]
)  # fmt: skip
"""What `Homing` and the decoder around the family's have in common."""


@helper
def leaps(reported: float, expected: float, step_m: float) -> bool:
    """Tell whether a reading is half a step or more from where the last one and its rate lead."""
    return bool(abs(reported - expected) >= 0.5 * step_m)


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
    """Adds to each length the turns that its drive has forgotten.

    A drive that was silent for long, or whose reading leaps by half a step and more, has been switched off:
    its turn is found anew, from where the leg was last seen. With its brake open nobody knows how far it
    went meanwhile, and its turn is lost.

    Mutable state: lengths as the drives report them, what is added, where each leg was last known, which
    turns are known or lost, what disagrees.
    """

    def __init__(self, pose: LastPose | None, stroke: Stroke, period_s: float) -> None:
        """Take where the legs stood; None: the drives forget nothing."""
        self._pose, self._stroke, self._period_s = pose, stroke, period_s
        self.record: Record = np.zeros((), HOMING)
        self.record["period_s"], self.record["step_m"] = period_s, ZERO6 if pose is None else pose.step_m
        self.added, self.raw = self.record["added"], self.record["raw"]
        """(6,) m each: whole multiples of the step; lengths as the drives report them."""
        self._known, self._lost = self.record["known"], self.record["lost"]
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick."""
        for name in ("added", "raw", "known", "lost", "wrong", "opened"):
            self.record[name] = 0
        self._last = ZERO6 if self._pose is None else self._pose.length.copy()
        self._wrong = [""] * LEGS

    @property
    def refusal(self) -> str:
        """Why the platform must not move; empty where every leg that was heard is where it was left."""
        wrong = "; ".join(filter(None, self._wrong))
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
        return self._pose is None or (bool(self._known.all()) and not any(self._wrong))

    def correct(self, tick: Record, last: Record, *, braked: bool) -> None:
        """Add the forgotten turns to the lengths of a tick.

        braked: the brakes have been proven shut since they were last open, or were not open.
        """
        if self._pose is None:
            return
        self.record["opened"] = self.opened or not braked
        raw: Array = tick["length"].copy()
        for leg, age in enumerate(tick["age"].tolist()):
            if self._known[leg] and (age > SILENT_TICKS or self._leaps(leg, raw, tick, last)):
                self._forget(leg, float(last["length"][leg]), braked=braked)
            if age <= 1 and not self._lost[leg] and (not self._known[leg] or self._wrong[leg]):
                self._find(leg, float(raw[leg]))
        self.raw[:], self.record["wrong"] = raw, list(map(bool, self._wrong))
        tick["length"] = raw + self.added

    def _leaps(self, leg: int, raw: Array, tick: Record, last: Record) -> bool:
        """Tell whether a reading is half a step or more from where the last one and its rate lead."""
        assert self._pose is not None
        ticks = int(tick["tick"]) - int(last["tick"]) + int(last["age"][leg]) - int(tick["age"][leg])
        expected = self.raw[leg] + last["rate"][leg] * ticks * self._period_s
        return leaps(raw[leg], expected, self._pose.step_m[leg])

    def _forget(self, leg: int, length: float, *, braked: bool) -> None:
        self._known[leg] = False
        self._last[leg] = length
        if not braked:
            self._lost[leg] = True
            self._wrong[leg] = (
                f"leg {leg}: its drive was switched off, or silent for {SILENT_TICKS} ticks, while its brake "
                "was open, so nobody knows how far the leg went"
            )

    def _find(self, leg: int, reported: float) -> None:
        assert self._pose is not None
        pose, there = self._pose, float(self._last[leg])
        step = float(pose.step_m[leg])
        self.added[leg] = step * round((there - reported) / step)
        self._known[leg] = True
        here, limit_m = reported + float(self.added[leg]), float(pose.limit_m[leg])
        if abs(here - there) > limit_m:
            turns = (there - here) / float(pose.m_per_turn[leg])
            self._wrong[leg] = (
                f"leg {leg} is {here:.6f} m long, and was {there:.6f} m ({pose.origin}): "
                f"{1e3 * (here - there):+.3f} mm, allowed: {1e3 * limit_m:g} mm (drives.homing); "
                f"{turns:+.3f} turns of its motor would mend it"
            )
            return
        self._wrong[leg] = self._out_of_range(leg)

    def _out_of_range(self, leg: int) -> str:
        """Say where the drive cannot report all of the stroke from where it was switched on."""
        stroke = self._stroke
        if stroke.reported is None:
            return ""
        low, high = (float(end[leg] + self.added[leg]) for end in stroke.reported)
        if low <= stroke.shortest and stroke.longest <= high:
            return ""
        return (
            f"leg {leg}: its drive was switched on where its position ends at leg lengths of {low:.4f} and "
            f"{high:.4f} m, allowed: {stroke.shortest:g} to {stroke.longest:g} m within them; switch it on "
            "with the leg nearer to mid-stroke"
        )


def unwrapped_turns(homing: Homing, pose: LastPose) -> Sequence[float]:
    """Return how many turns of each motor are added to what its drive reports."""
    return [round(float(turns), 6) + 0.0 for turns in np.divide(homing.added, pose.m_per_turn)]  # -0 is 0
