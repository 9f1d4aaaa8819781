"""As what a fault of the plant's end may be named: one row a kind, with the reason.

A run that names one of them has named the cause. Where the fault is a leg's, the leg has to be named with it.
What else follows from the fault may be named beside that.
"""

from collections.abc import Iterable
from typing import NamedTuple

from drivers.signals import Fault


class Expected(NamedTuple):
    """What one kind of fault may be named as."""

    causes: frozenset[str]
    """Names of Fault; of ENCODER maybe with a Doubt, as `ENCODER/LEAP`. Any one of them is right."""
    why: str


def _row(causes: str, why: str) -> Expected:
    return Expected(frozenset(causes.split()), why)


PLANT_FAILS = ("plant_crash", "plant_nan", "plant_hang")
"""Kinds that may end as a failure of the plant."""
COMMANDS_LOST = frozenset(
    {"bus_off", "bus_flood", "frames_loss", "frames_delay", "frames_reorder", "frames_corrupt"}
)
"""Kinds under which drives may not hear that they are to switch off."""
STRANGERS = frozenset({"frames_forged_command", "bus_second_controller"})
"""Kinds whose RUN comes after each of our own commands, as long as they last."""
NAMES_NO_LEG = frozenset({"CERTIFICATE", "KINEMATICS", "ASSEMBLY", "CONDITION", "REFUSED_FRAMES"})
"""Faults of the platform or the bus as a whole: which leg they come from cannot be told."""
_FORCE = "DRIVE FOLLOWING SPEED CERTIFICATE ENCODER/LEAP"
_UNHEARD = "STALE DRIVE BUS"
EXPECTED: dict[str, Expected] = {
    "encoder_jump": _row("ENCODER", "the length contradicts the rate from one reading to the next"),
    "encoder_freeze": _row("ENCODER", "a rate that leaps to zero, or a reading that stands still"),
    "encoder_drift": _row(
        "ENCODER BRAKE", "of length and rate alike, it is seen where the leg has to stand: as motion of it"
    ),
    "encoder_noise": _row("ENCODER", "each reading jumps beside its rate"),
    "encoder_late": _row("ENCODER", "it stands still at first; then nothing shows it"),
    "encoder_scale": _row("ENCODER BRAKE", "as of the drift; a rate that is scaled at once leaps"),
    "encoder_sign": _row(
        "ENCODER DRIVE FOLLOWING SPEED CERTIFICATE STROKE",
        "at rest nothing shows it but that the leg then runs away: the same as a force of the wrong sign",
    ),
    "encoder_lost": _row("STALE", "the drive says that its length is of no use: the leg is not heard"),
    "drive_silence": _row("STALE", "the leg is not heard"),
    "drive_reset": _row("DRIVE SET_UP", "the drive is in BOOT, and its set-up is forgotten"),
    "drive_gain": _row(_FORCE, "a force along one leg that the commands do not explain"),
    "drive_sign": _row(_FORCE, "as of the gain; the leg gets faster against its force"),
    "drive_saturation": _row(_FORCE, "as of the gain"),
    "brake_stuck_open": _row("BRAKE", "the leg moves where its brake has to hold"),
    "brake_stuck_closed": _row(
        "FOLLOWING ENCODER/STILL ENCODER/LEAP",
        "the leg stands while its reference moves, as with a frozen encoder; in motion a force along it",
    ),
    "brake_slow": _row(
        "BRAKE FOLLOWING ENCODER/STILL", "it closes late: the leg moves; it opens late: as one that is stuck"
    ),
    "brake_slipping": _row("BRAKE", "the leg moves where its brake has to hold"),
    "frames_loss": _row(
        _UNHEARD, "feedback is missing, or commands: drives stop by their watchdog, if they have one"
    ),
    "frames_duplicate": _row("", "a frame that comes twice says nothing new"),
    "frames_delay": _row(_UNHEARD, "a frame of an older SYNC counts for nothing, at either end"),
    "frames_reorder": _row(_UNHEARD, "as of the delay"),
    "frames_corrupt": _row(f"REFUSED_FRAMES {_UNHEARD}", "the checks refuse them, at either end"),
    "frames_forged_command": _row("SECOND_CONTROLLER", "a command that was not sent here is heard"),
    "frames_forged_feedback": _row(
        "DUPLICATE_NODE ENCODER",
        "two answers to one SYNC differ; of drives that send readings unasked the newest counts: it leaps",
    ),
    "frames_old": _row(
        "SECOND_CONTROLLER DUPLICATE_NODE ENCODER",
        "a command that was not sent here, or a second answer, is heard; or a reading leaps",
    ),
    "bus_off": _row("BUS STALE", "the interface says so, or nobody is heard"),
    "bus_flood": _row(_UNHEARD, "no frame gets through"),
    "bus_second_controller": _row("SECOND_CONTROLLER", "its SYNC and its commands are heard"),
    "plant_nan": _row("STALE NOT_FINITE DRIVE", "drives without a length call it of no use, or fail"),
    "plant_hang": _row("STALE", "no leg is heard"),
    "plant_crash": _row("STALE", "no leg is heard, where the plant's end lives on"),
    "wrench_step": _row("FOLLOWING SPEED CERTIFICATE BRAKE", "a load moves the platform, or slips a brake"),
    "payload_step": _row("FOLLOWING SPEED CERTIFICATE BRAKE", "as of the wrench"),
}
"""Of every kind of the matrix."""


def expects(causes: Iterable[str], cause: str) -> bool:
    """Tell whether a cause is among the expected ones, where ENCODER alone means any doubt."""
    return any(each in (cause, cause.partition("/")[0]) for each in causes)


def bits_of(causes: Iterable[str]) -> int:
    """Return the faults of some causes."""
    bits = Fault.NONE
    for cause in causes:
        bits |= Fault[cause.partition("/")[0]]
    return int(bits)
