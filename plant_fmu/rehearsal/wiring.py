"""The wiring of a rehearsal bench: the actual connections and mistakes that a bring-up has to find.

Every tuple has one element per drive, in the leg order of the configuration, or per leg if that is stated.
"""

from dataclasses import dataclass, replace
from functools import reduce
from math import inf
from typing import Any, cast

from drivers.signals import LEGS

OWN = tuple(range(LEGS))
OWN_BRAKES = tuple(frozenset((leg,)) for leg in OWN)
ONES = (1.0,) * LEGS
ZEROS = (0.0,) * LEGS
NONE = (None,) * LEGS


@dataclass(frozen=True)
class Wiring:
    """Actual drives, motors, encoders, brakes and joints of a machine; the defaults have no mistake."""

    motor: tuple[int, ...] = OWN
    """Leg that the motor of each drive moves."""
    encoder: tuple[int, ...] = OWN
    """Leg that the encoder of each drive measures."""
    brake: tuple[frozenset[int], ...] = OWN_BRAKES
    """Legs whose brakes each drive opens."""
    force_gain: tuple[float, ...] = ONES
    """Force at the leg per force of the drive."""
    scale: tuple[float, ...] = ONES
    """Change of the reading per change of the leg's length."""
    offset_m: tuple[float, ...] = ZEROS
    """Reading minus length at the middle of the stroke."""
    rate_scale: tuple[float, ...] = ONES
    """Measured rate per rate of change of the reading."""
    force_one_way: tuple[bool, ...] = (False,) * LEGS
    """The drive cannot give a force that is negative in its own sign."""
    force_most: tuple[float, ...] = (inf,) * LEGS
    """Largest force of the drive, as a share of the rated force."""
    frozen: tuple[bool, ...] = (False,) * LEGS
    """The encoder keeps its reading at power-up."""
    stuck: tuple[float | None, ...] = NONE
    """Per leg: position of a stuck brake, 1 closed, 0 open; None for one that works."""
    brake_share: tuple[float, ...] = ONES
    """Per leg: share of its force that the brake has."""
    brake_inverted: tuple[bool, ...] = (False,) * LEGS
    """Per leg: the brake closes when it should open."""
    jump_m: tuple[float, ...] = ZEROS
    """Jump of the reading beyond the middle of the stroke."""
    stops: tuple[bool, ...] = (False,) * LEGS
    """Beyond the middle of the stroke the reading stays that of the middle."""
    play_m: tuple[float, ...] = ZEROS
    """Play: motion of the leg before the encoder follows."""
    friction: tuple[float, ...] = ZEROS
    """Per leg: additional friction, as a share of the rated force."""
    present: tuple[bool, ...] = (True,) * LEGS
    """The drive has power and a bus."""
    answers_as: tuple[int, ...] = OWN
    """Leg whose node number each drive has."""
    watchdog: tuple[float, ...] = ONES
    """Factor on the drive's watchdog time; inf: it has no watchdog, and does not report this."""
    other_protocol: tuple[bool, ...] = (False,) * LEGS
    """The drive uses CANopen as at delivery: it sends a heartbeat in pre-operational and nothing else."""
    shorter: tuple[float, ...] = ZEROS
    """Per leg: share of the stroke that is missing at its long end."""
    base_joint: tuple[int, ...] = OWN
    """Per leg: the base joint at which it is mounted."""
    platform_joint: tuple[int, ...] = OWN
    """Per leg: the platform joint at which it is mounted."""
    joint_off_m: tuple[float, ...] = ZEROS
    """Per leg: distance by which its base joint is too far outwards."""
    home_off_m: float = 0.0
    """Height of the platform above its known poses, m."""
    payload: float = 1.0
    """Factor on mass and inertia of the platform."""
    gravity: float = 1.0
    """-1: the machine hangs from the ceiling."""
    brake_late_s: tuple[float, ...] = ZEROS
    """Per leg: delay with which its brake closes."""
    encoder_late_s: tuple[float, ...] = ZEROS
    """Per drive: age of its encoder reading."""
    force_lag_s: tuple[float, ...] = ZEROS
    """Per drive: time constant of its force."""
    coupling: tuple[float, ...] = (inf,) * LEGS
    """Per drive: force at which its coupling slips, as a share of the rated force."""
    frames_lost: float = 0.0
    """Share of the frames lost in each direction."""
    mounting: "Wiring | None" = None
    """Wiring after the platform is mounted; None: no change."""

    @property
    def as_mounted(self) -> "Wiring":
        """Wiring that holds after the platform is mounted."""
        return self.mounting or self


@dataclass(frozen=True)
class Mistake:
    """One wiring mistake, and the legs that it concerns."""

    name: str
    """Key of MISTAKES."""
    leg: int
    """Leg or drive, 0..5."""
    other: int = -1
    """Second leg or drive of a mistake that concerns two."""
    third: int = -1
    """The third leg or drive of a rotation."""
    value: float | None = None
    """Size of the mistake; None: the usual size in MISTAKES."""
    mounting: bool = False
    """The mistake is made when the platform is mounted, after the tests on trestles."""


MISTAKES: dict[str, tuple[str, int, tuple[float, ...], str]] = {
    "ids_swapped": ("motor encoder brake", 2, (), "node numbers of two drives exchanged"),
    "ids_rotated": ("motor encoder brake", 3, (), "node numbers rotated among three drives"),
    "motor_crossed": ("motor", 2, (), "motor cables of two drives exchanged"),
    "encoder_crossed": ("encoder", 2, (), "encoder cables of two drives exchanged"),
    "brake_crossed": ("brake", 2, (), "brake cables of two drives exchanged"),
    "brake_of_another": ("brake", 1, (), "the drive also opens the brake of another leg"),
    "mounted_elsewhere": ("base_joint", 2, (), "base joints of two legs exchanged"),
    "platform_end_elsewhere": ("platform_joint", 2, (), "platform joints of two legs exchanged"),
    "encoder_counts_another": (
        "encoder",
        1,
        (),
        "two encoders measure one leg: an encoder is fitted to another leg",
    ),
    "same_id": ("answers_as", 1, (), "a drive has the node number of another one"),
    "encoder_sign": ("scale", 1, (-1.0, -4.0, -0.25), "the encoder counts backwards"),
    "encoder_scale": ("scale", 1, (2.0, 0.01, 100.0), "wrong encoder resolution"),
    "rate_sign": ("rate_scale", 1, (-1.0, -100.0, -0.01), "the rate has the opposite sign of the position"),
    "rate_scale": ("rate_scale", 1, (2.0, 0.0, 100.0), "the rate is not in the unit of the position"),
    "force_one_way": ("force_one_way", 1, (1.0,), "the motor can only pull, or only push"),
    "force_saturates": (
        "force_most",
        1,
        (0.008, 0.0, 1.0),
        "the drive force saturates; size: share of the rated force",
    ),
    "force_sign": ("force_gain", 1, (-1.0, -4.0, -0.25), "motor phases exchanged: force reversed"),
    "force_scale": ("force_gain", 1, (0.5, 0.0, 100.0), "force too large or too small"),
    "wrong_lead": ("scale force_gain", 1, (1.25, 0.25, 4.0), "wrong lead or gear ratio"),
    "drive_reversed": ("scale force_gain", 1, (-1.0, -4.0, -0.25), "motor and encoder reversed"),
    "encoder_frozen": ("frozen", 1, (1.0,), "the encoder reading is frozen"),
    "encoder_jumps": ("jump_m", 1, (6e-3, -0.1, 0.1), "the encoder reading jumps at mid-stroke; size: m"),
    "encoder_stops": ("stops", 1, (1.0,), "the encoder reading stops at mid-stroke"),
    "backlash": ("play_m", 1, (0.005, 0.0, 0.1), "play between leg and encoder; size: m"),
    "offset": ("offset_m", 1, (0.004, -0.1, 0.1), "homing error of the encoder; size: m"),
    "brake_stuck_shut": ("stuck", 1, (1.0,), "the brake does not open"),
    "brake_stuck_open": ("stuck", 1, (0.0,), "the brake does not close"),
    "brake_inverted": ("brake_inverted", 1, (1.0,), "the brake closes when it should open"),
    "brake_weak": ("brake_share", 1, (0.01, 0.0, 1.0), "the brake is too weak; size: share of its force"),
    "brake_late": ("brake_late_s", 1, (0.2, 0.0, 1.0), "the brake closes late; size: delay, s"),
    "encoder_late": ("encoder_late_s", 1, (0.02, 0.0, 0.2), "the encoder reading is old; size: age, s"),
    "force_lags": ("force_lag_s", 1, (0.05, 0.0, 1.0), "the drive's force lags; size: time constant, s"),
    "coupling_slips": (
        "coupling",
        1,
        (0.01, 0.0, 1.0),
        "the coupling slips; size: force at which it slips, share of the rated force",
    ),
    "friction": ("friction", 1, (0.012, 0.0, 1.0), "additional friction; size: share of the rated force"),
    "end_stop": ("shorter", 1, (0.15, 0.0, 0.9), "part of the stroke is blocked; size: share of it"),
    "watchdog_missing": ("watchdog", 1, (inf,), "the drive has no watchdog"),
    "watchdog_long": ("watchdog", 1, (8.0, 1.0, 100.0), "watchdog time too long; size: factor"),
    "watchdog_short": ("watchdog", 1, (0.3, 0.01, 1.0), "watchdog time too short; size: factor"),
    "absent": ("present", 1, (0.0,), "a drive without power or bus"),
    "wrong_protocol": ("other_protocol", 1, (1.0,), "the drive uses CANopen with factory settings"),
    "joint_elsewhere": ("joint_off_m", 1, (0.03, -0.1, 0.1), "the base joint is too far outwards; size: m"),
    "wrong_home": ("home_off_m", 0, (0.015, -0.1, 0.1), "the platform is too high at home; size: m"),
    "payload": ("payload", 0, (2.0, 0.1, 10.0), "wrong mass and inertia of the platform; size: factor"),
    "frames_lost": ("frames_lost", 0, (0.05, 0.0, 0.9), "frames are lost; size: share of all frames"),
    "upside_down": ("gravity", 0, (-1.0,), "the machine hangs from the ceiling"),
}
"""Name -> fields of Wiring that it changes, number of legs, sizes, description.

A mistake of 0 legs concerns the whole machine. Sizes are the usual one, and the smallest and the largest that
can be requested, if a size can be stated."""
OF_WATCHDOG = frozenset(name for name, (fields, *_) in MISTAKES.items() if "watchdog" in fields.split())
"""Mistakes of drives that have a watchdog."""


def wired(*mistakes: Mistake) -> Wiring:
    """Wiring with some mistakes. Raises ValueError on an unknown mistake or a leg outside 0..5."""
    wiring = reduce(_with, (each for each in mistakes if not each.mounting), Wiring())
    late = [each for each in mistakes if each.mounting]
    return replace(wiring, mounting=reduce(_with, late, wiring)) if late else wiring


def legs_of(name: str) -> int:
    """Number of legs that a mistake needs, 0 to 3; 0: it concerns the whole machine."""
    return 2 if name in _ONTO_ANOTHER else MISTAKES[name][1]


def _with(wiring: Wiring, mistake: Mistake) -> Wiring:
    if mistake.name not in MISTAKES:
        raise ValueError(f"mistake {mistake.name!r}: unknown, allowed: {', '.join(MISTAKES)}")
    fields, count, size, _ = MISTAKES[mistake.name]
    legs = (mistake.leg, mistake.other, mistake.third)[: legs_of(mistake.name)]
    if any(not 0 <= leg < LEGS for leg in legs) or len(set(legs)) != len(legs):
        raise ValueError(f"mistake {mistake.name}: different legs 0 to 5 are allowed, given: {list(legs)}")
    value = next(iter(size), None) if mistake.value is None else mistake.value
    changes: dict[str, object] = {}
    for field in fields.split():
        there = getattr(wiring, field)
        new = [] if count == 0 else list(there)
        if count > 1:
            for leg, before in zip(legs, (*legs[1:], legs[0]), strict=True):
                new[leg] = there[before]
        elif len(legs) == 2:
            new[mistake.leg] = there[mistake.leg] | {mistake.other} if field == "brake" else mistake.other
        elif legs:
            assert value is not None
            old = there[mistake.leg]
            factor = old if field in _FACTORS else 1.0
            new[mistake.leg] = bool(value) if isinstance(old, bool) else factor * value
        changes[field] = tuple(new) if legs else value
    return replace(wiring, **cast("Any", changes))


_ONTO_ANOTHER = frozenset({"encoder_counts_another", "same_id", "brake_of_another"})
"""Mistakes in which one leg gets the part of another leg, which keeps it."""
_FACTORS = frozenset({"scale", "rate_scale", "force_gain", "watchdog"})
