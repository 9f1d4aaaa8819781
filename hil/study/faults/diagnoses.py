"""Expected diagnosis of each kind of injected fault; docs/guides/faults.md gives the reasons.

A run that reports one of the expected faults has found the cause. A cause at one leg must be reported with
that leg. Consequences of the cause may be reported, too.
"""

from collections.abc import Iterable

from drivers.signals import Fault

PLANT_FAILS = ("plant_crash", "plant_nan", "plant_hang")
"""Kinds that may end as a failure of the plant."""
COMMANDS_LOST = frozenset(
    {"bus_off", "bus_flood", "frames_loss", "frames_delay", "frames_reorder", "frames_corrupt"}
)
"""Kinds that can keep the command to switch off from the drives."""
FOREIGN_COMMANDS = frozenset({"frames_forged_command", "bus_second_controller"})
"""Kinds that send RUN after each of our own commands, as long as they last."""
NAMES_NO_LEG = frozenset({"CERTIFICATE", "KINEMATICS", "ASSEMBLY", "CONDITION", "REFUSED_FRAMES"})
"""Faults of the platform or the bus as a whole, which cannot be attributed to a leg."""
_FORCE = "DRIVE FOLLOWING SPEED CERTIFICATE ENCODER/LEAP"
_UNHEARD = "STALE DRIVE BUS"
EXPECTED = {
    kind: frozenset(causes.split())
    for kind, causes in {
        "encoder_jump": "ENCODER",
        "encoder_freeze": "ENCODER",
        "encoder_drift": "ENCODER BRAKE",
        "encoder_noise": "ENCODER",
        "encoder_late": "ENCODER",
        "encoder_scale": "ENCODER BRAKE",
        "encoder_sign": "ENCODER DRIVE FOLLOWING SPEED CERTIFICATE STROKE",
        "encoder_lost": "STALE",
        **dict.fromkeys(("sensor_lost", "sensor_late", "sensor_frozen"), "ENCODER/EITHER"),
        **dict.fromkeys(("sensor_offset", "sensor_drift", "sensor_outlier"), "ENCODER/EITHER"),
        "drive_silence": "STALE",
        "drive_reset": "DRIVE SET_UP",
        "drive_gain": _FORCE,
        "drive_sign": _FORCE,
        "drive_saturation": _FORCE,
        "brake_stuck_open": "BRAKE",
        "brake_stuck_closed": "FOLLOWING ENCODER/STILL ENCODER/LEAP",
        "brake_slow": "BRAKE FOLLOWING ENCODER/STILL",
        "brake_slipping": "BRAKE",
        "frames_loss": _UNHEARD,
        "frames_duplicate": "",
        "frames_delay": _UNHEARD,
        "frames_reorder": _UNHEARD,
        "frames_corrupt": f"REFUSED_FRAMES {_UNHEARD}",
        "frames_forged_command": "SECOND_CONTROLLER",
        "frames_forged_feedback": "DUPLICATE_NODE ENCODER",
        "frames_old": "SECOND_CONTROLLER DUPLICATE_NODE ENCODER",
        "bus_off": "BUS STALE",
        "bus_flood": _UNHEARD,
        "bus_second_controller": "SECOND_CONTROLLER",
        "plant_nan": "STALE NOT_FINITE DRIVE",
        "plant_hang": "STALE",
        "plant_crash": "STALE",
        "wrench_step": "FOLLOWING SPEED CERTIFICATE BRAKE",
        "payload_step": "FOLLOWING SPEED CERTIFICATE BRAKE",
    }.items()
}
"""Kind -> names of Fault, each of which is a correct diagnosis; ENCODER may be followed by a Doubt."""


def expects(causes: Iterable[str], cause: str) -> bool:
    """True if a reported cause is among the expected ones; `ENCODER` alone covers any encoder error."""
    return any(each in (cause, cause.partition("/")[0]) for each in causes)


def bits_of(causes: Iterable[str]) -> int:
    """Bits of Fault for names of causes, e.g. `ENCODER/JUMP`."""
    bits = Fault.NONE
    for cause in causes:
        bits |= Fault[cause.partition("/")[0]]
    return int(bits)
