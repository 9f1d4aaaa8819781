"""What is wired to what on a rehearsal bench: the truth that a bring-up has to find out.

Every tuple has one element a drive, in the leg order of the configuration, unless it says a leg.
"""

from dataclasses import dataclass, replace
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
    """Drives, motors, encoders, brakes and joints, as they are; by default as they should be."""

    motor: tuple[int, ...] = OWN
    """Leg that the motor of each drive moves."""
    encoder: tuple[int, ...] = OWN
    """Leg that the encoder of each drive counts."""
    brake: tuple[frozenset[int], ...] = OWN_BRAKES
    """Legs whose brakes each drive opens."""
    force_gain: tuple[float, ...] = ONES
    """N at the leg for each N that the drive believes to give."""
    scale: tuple[float, ...] = ONES
    """m of reading for each m of the leg."""
    offset_m: tuple[float, ...] = ZEROS
    """Reading less length at the middle of the stroke."""
    rate_scale: tuple[float, ...] = ONES
    """m/s of rate for each m/s that the reading changes by."""
    force_one_way: tuple[bool, ...] = (False,) * LEGS
    """The drive gives no force that is below zero to its own mind."""
    force_most: tuple[float, ...] = (inf,) * LEGS
    """Most force that the drive gives, as a share of the rated one."""
    frozen: tuple[bool, ...] = (False,) * LEGS
    """The encoder reads what it read at power-up."""
    stuck: tuple[float | None, ...] = NONE
    """Of each leg: where its brake stays, 1 shut, 0 open; None for one that works."""
    brake_share: tuple[float, ...] = ONES
    """Of each leg: share of its force that the brake has."""
    brake_inverted: tuple[bool, ...] = (False,) * LEGS
    """Of each leg: its brake shuts when it should open."""
    jump_m: tuple[float, ...] = ZEROS
    """The reading is so much more beyond the middle of the stroke."""
    stops: tuple[bool, ...] = (False,) * LEGS
    """The reading stays that of the middle beyond it."""
    play_m: tuple[float, ...] = ZEROS
    """The leg moves so far before the encoder follows it."""
    friction: tuple[float, ...] = ZEROS
    """Of each leg: friction beyond the usual, as a share of the rated force."""
    present: tuple[bool, ...] = (True,) * LEGS
    """The drive has power and a bus."""
    answers_as: tuple[int, ...] = OWN
    """Whose node number each drive has been given."""
    watchdog: tuple[float, ...] = ONES
    """Factor on the drive's watchdog; inf: it has none, and says nothing of it."""
    other_protocol: tuple[bool, ...] = (False,) * LEGS
    """The drive speaks CANopen as delivered: a heartbeat in pre-operational, nothing else."""
    shorter: tuple[float, ...] = ZEROS
    """Of each leg: share of the stroke that is missing at its long end."""
    base_joint: tuple[int, ...] = OWN
    """Of each leg: the base joint at which it is mounted."""
    platform_joint: tuple[int, ...] = OWN
    """Of each leg: the platform joint at which it is mounted."""
    joint_off_m: tuple[float, ...] = ZEROS
    """Of each leg: so far its base joint is outside of where it should be."""
    home_off_m: float = 0.0
    """The platform hangs so much above the known poses."""
    payload: float = 1.0
    """Mass and inertia of the platform are so many times what they should be."""
    gravity: float = 1.0
    """-1: the machine hangs from the ceiling."""


@dataclass(frozen=True)
class Mistake:
    """One mistake of who wired the machine."""

    name: str
    """A row of MISTAKES."""
    leg: int
    """Leg or drive, 0..5."""
    other: int = -1
    """The second one where two take part."""
    third: int = -1
    """The third one of a rotation."""
    value: float | None = None
    """Size; None is the one of the table."""


MISTAKES: dict[str, tuple[str, int, float | None, tuple[float, float] | None, str]] = {
    "ids_swapped": ("motor encoder brake", 2, None, None, "node numbers of two drives exchanged"),
    "ids_rotated": ("motor encoder brake", 3, None, None, "node numbers of three drives handed round"),
    "motor_crossed": ("motor", 2, None, None, "motor cables of two drives exchanged"),
    "encoder_crossed": ("encoder", 2, None, None, "encoder cables of two drives exchanged"),
    "brake_crossed": ("brake", 2, None, None, "brake cables of two drives exchanged"),
    "brake_of_another": ("brake", 1, None, None, "the drive's output opens another leg's brake, too"),
    "mounted_elsewhere": ("base_joint", 2, None, None, "two legs mounted at each other's base joint"),
    "platform_end_elsewhere": ("platform_joint", 2, None, None, "two legs at each other's platform joint"),
    "encoder_counts_another": ("encoder", 1, None, None, "it counts another leg, beside that leg's own"),
    "same_id": ("answers_as", 1, None, None, "a drive has the node number of another one"),
    "encoder_sign": ("scale", 1, -1.0, (-4.0, -0.25), "the encoder counts backwards"),
    "encoder_scale": ("scale", 1, 2.0, (0.01, 100.0), "the encoder counts too much or too little"),
    "rate_sign": ("rate_scale", 1, -1.0, (-100.0, -0.01), "the rate has the other sign than the position"),
    "rate_scale": ("rate_scale", 1, 2.0, (0.0, 100.0), "the drive's rate has another unit than its position"),
    "force_one_way": ("force_one_way", 1, 1.0, None, "the motor pulls, and does not push, or the reverse"),
    "force_saturates": ("force_most", 1, 0.008, (0.0, 1.0), "weak supply: most force, as a share of rated"),
    "force_sign": ("force_gain", 1, -1.0, (-4.0, -0.25), "motor phases exchanged: force the other way"),
    "force_scale": ("force_gain", 1, 0.5, (0.0, 100.0), "force too large or too small"),
    "wrong_lead": ("scale force_gain", 1, 1.25, (0.25, 4.0), "another lead or gear than the drive believes"),
    "drive_reversed": ("scale force_gain", 1, -1.0, (-4.0, -0.25), "motor and encoder the other way round"),
    "encoder_frozen": ("frozen", 1, 1.0, None, "the encoder stands still"),
    "encoder_jumps": ("jump_m", 1, 6e-3, (-0.1, 0.1), "the encoder reads so much more beyond mid-stroke, m"),
    "encoder_stops": ("stops", 1, 1.0, None, "the encoder stands still beyond mid-stroke"),
    "backlash": ("play_m", 1, 5e-3, (0.0, 0.1), "play between leg and encoder, m"),
    "offset": ("offset_m", 1, 4e-3, (-0.1, 0.1), "homed at another length, m"),
    "brake_stuck_shut": ("stuck", 1, 1.0, None, "the brake does not open"),
    "brake_stuck_open": ("stuck", 1, 0.0, None, "the brake does not shut"),
    "brake_inverted": ("brake_inverted", 1, 1.0, None, "the brake shuts when it should open"),
    "brake_weak": ("brake_share", 1, 0.01, (0.0, 1.0), "the brake has this share of its force"),
    "friction": ("friction", 1, 0.012, (0.0, 1.0), "friction beyond the usual, share of the rated force"),
    "end_stop": ("shorter", 1, 0.15, (0.0, 0.9), "an end stop in the way, share of the stroke"),
    "watchdog_missing": ("watchdog", 1, inf, None, "the drive has no watchdog"),
    "watchdog_long": ("watchdog", 1, 8.0, (1.0, 100.0), "the watchdog takes so many times what was set"),
    "watchdog_short": ("watchdog", 1, 0.3, (0.01, 1.0), "the watchdog takes this share of what was set"),
    "absent": ("present", 1, 0.0, None, "no power, or no bus, at a drive"),
    "wrong_protocol": ("other_protocol", 1, 1.0, None, "the drive speaks CANopen as delivered"),
    "joint_elsewhere": ("joint_off_m", 1, 0.03, (-0.1, 0.1), "the base joint is so much further outside, m"),
    "wrong_home": ("home_off_m", 0, 0.015, (-0.1, 0.1), "the platform hangs so much too high, m"),
    "payload": ("payload", 0, 2.0, (0.1, 10.0), "the platform weighs so many times what is configured"),
    "upside_down": ("gravity", 0, -1.0, None, "the machine hangs from the ceiling"),
}
"""Name -> fields of Wiring that it changes, legs that take part, usual size, what it is.

Between the last two: the least and largest size that somebody may ask for, None where it has no size. One in
which no leg takes part is of the whole machine.
"""
OF_WATCHDOG = frozenset(name for name, (fields, *_) in MISTAKES.items() if fields == "watchdog")
"""Mistakes of drives that have a watchdog."""


def wired(*mistakes: Mistake) -> Wiring:
    """Return the wiring with some mistakes. Raises ValueError: unknown, or a leg that does not exist."""
    wiring = Wiring()
    for mistake in mistakes:
        wiring = _with(wiring, mistake)
    return wiring


def legs_of(name: str) -> int:
    """Return how many legs a mistake has to name: `leg`, `other`, `third`; 0: it is of the whole machine."""
    return 2 if name in _ONTO_ANOTHER else MISTAKES[name][1]


def _with(wiring: Wiring, mistake: Mistake) -> Wiring:
    if mistake.name not in MISTAKES:
        raise ValueError(f"mistake {mistake.name!r}: unknown, allowed: {', '.join(MISTAKES)}")
    fields, count, usual, *_ = MISTAKES[mistake.name]
    legs = (mistake.leg, mistake.other, mistake.third)[: legs_of(mistake.name)]
    if any(not 0 <= leg < LEGS for leg in legs) or len(set(legs)) != len(legs):
        raise ValueError(f"mistake {mistake.name}: different legs 0 to 5 are allowed, given: {list(legs)}")
    value = usual if mistake.value is None else mistake.value
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
"""One leg's is that of another, which keeps its own."""
_FACTORS = frozenset({"scale", "rate_scale", "force_gain", "watchdog"})
