"""Golden cases with faults: each kind while tracking, the important ones also in other modes and machines."""

from __future__ import annotations

from typing import Any

from tests.golden.runner import Case
from tools.drive_families import FAMILIES, merged

Changes = dict[str, Any]

SOON: Changes = {
    "engage": {"force_ramp_s": 0.05, "brake_release_s": 0.02, "blend_s": 0.1, "stop_s": 0.3},
    "plant": {"drives": {"brake_open_ms": 20, "brake_close_ms": 20}},
}
"""Shorter waits before the path."""
STILL: Changes = {**SOON, "reference": {"type": "hold", "duration_s": 0.3}}
FAULTS = {
    "encoder_jump": "leg=2 by=0.005",
    "encoder_freeze": "leg=2",
    "encoder_drift": "leg=2 by=0.02",
    "encoder_noise": "leg=2 sigma=0.0001",
    "encoder_late": "leg=2 by=2",
    "encoder_scale": "leg=2 factor=1.05",
    "encoder_sign": "leg=2",
    "encoder_lost": "leg=2",
    "drive_silence": "leg=2",
    "drive_reset": "leg=2",
    "drive_gain": "leg=2 factor=0.5",
    "drive_sign": "leg=2",
    "drive_saturation": "leg=2 limit=1800",
    "brake_stuck_open": "leg=2",
    "brake_stuck_closed": "leg=2",
    "brake_slow": "leg=2 by=200",
    "brake_slipping": "leg=2 share=0.09",
    "frames_loss": "probability=0.3",
    "frames_duplicate": "",
    "frames_delay": "by=2",
    "frames_reorder": "probability=0.5",
    "frames_corrupt": "probability=0.3",
    "frames_forged_command": "force=3000",
    "frames_forged_feedback": "leg=2 by=0.005",
    "frames_old": "",
    "bus_off": "",
    "bus_flood": "",
    "bus_second_controller": "",
    "plant_nan": "",
    "plant_hang": "",
    "plant_crash": "",
    "wrench_step": "force=0,0,-2800",
    "payload_step": "mass=230 position=0.2,0,0.2",
}
"""Kind -> its parameters on `virtual`."""
IMPORTANT = (
    "encoder_jump", "encoder_freeze", "encoder_drift", "drive_silence", "drive_reset", "brake_stuck_open",
    "brake_stuck_closed", "bus_off", "frames_loss", "frames_delay", "frames_forged_command",
    "bus_second_controller", "frames_forged_feedback",
)  # fmt: skip
FAULTY: dict[str, Case] = {}
FAULTY |= {
    f"{kind} while tracking": Case(
        "virtual", SOON, [f"{kind} mode=TRACKING at=0.3 {words}"], duration_s=0.8, longest_s=1.5
    )
    for kind, words in FAULTS.items()
}
FAULTY["bus_flood while tracking"] = FAULTY["bus_flood while tracking"]._replace(longest_s=0.8)
FAULTY |= {
    f"{kind} {when}": Case("virtual", changes, [f"{kind} mode={mode} at=0.015 {FAULTS[kind]}"], longest_s=1.4, duration_s=0.6)
    for kind in IMPORTANT
    for when, mode, changes in (
        ("at hold", "HOLD", STILL), ("while parking", "PARKING", STILL), ("while loading", "LOADING", SOON),
    )
}  # fmt: skip
OTHERS = (
    ("two_buses", "bus_off bus=1"),
    ("two_buses", "bus_off bus=0 for=0.001"),
    ("two_buses", "bus_flood bus=1"),
    ("two_buses", "bus_second_controller bus=1 rate=2000"),
    ("two_buses", "drive_silence leg=4"),
    ("two_buses", "encoder_jump leg=4 by=0.005"),
    ("two_buses", "frames_loss probability=0.1"),
    ("two_buses", "frames_duplicate for=0.02"),
    ("desktop", "drive_silence leg=2"),
    ("desktop", "drive_reset leg=2"),
    ("desktop", "encoder_freeze leg=2"),
    ("desktop", "frames_loss probability=0.1"),
    ("virtual-cia402", "drive_silence leg=2"),
    ("virtual-cia402", "drive_reset leg=2"),
    ("virtual-cia402", "encoder_jump leg=2 by=0.005"),
    ("virtual-cia402", "frames_corrupt probability=0.1"),
    ("bench", "drive_silence leg=2"),
    ("ideal", "encoder_jump leg=2 by=0.005"),
)
FAULTY |= {
    f"{words} on {name}": Case(name, SOON, [f"{words} mode=TRACKING at=0.2"], duration_s=1.0, longest_s=1.5)
    for name, words in OTHERS
}
FAULTY["bus_flood bus=1 on two_buses"] = FAULTY["bus_flood bus=1 on two_buses"]._replace(longest_s=0.65)
FAULTY |= {
    f"drive_reset on {family}": Case(
        "desktop",
        merged(SOON, FAMILIES[family]),
        ["drive_reset mode=TRACKING at=0.1 leg=2"],
        duration_s=1.2,
        longest_s=1.6,
    )
    for family in ("moteus", "odrive", "mit, robstride rs-02", "cia402, pdo", "mit, mini_cheetah")
}
FAULTY |= {
    f"silence of {ticks} ticks": Case(
        "virtual", SOON, [f"drive_silence leg=3 mode=TRACKING at=0.2005 for={1e-3 * ticks:g}"], duration_s=0.7, longest_s=1.6
    )
    for ticks in (1, 2, 4, 5, 6)
}  # fmt: skip
FAULTY |= {
    **{
        f"no feedback at all for {ticks} ticks": Case(
            "virtual", SOON, [f"drive_silence leg={leg} mode=TRACKING at=0.2005 for={1e-3 * ticks:g}" for leg in range(6)],
            duration_s=0.7, longest_s=1.6,
        )
        for ticks in (4, 5)
    },
    "bus off for 4 ticks": Case("virtual", SOON, ["bus_off mode=TRACKING at=0.2005 for=0.004"], duration_s=0.7, longest_s=1.6),
    "the bus works again after bus off": Case("virtual", SOON, ["bus_off mode=TRACKING at=0.2 for=0.05"], duration_s=0.7, longest_s=1.6),
    "a stop while loading": Case("virtual", SOON, duration_s=0.12, longest_s=1.6),
    "a drive never answers": Case("virtual", SOON, ["drive_silence leg=5"], longest_s=1.0),
    "the certificate faults": Case(
        "virtual", {**SOON, "monitor": {"action": "fault", "disturbance_m_s2": 0.5}},
        ["wrench_step mode=TRACKING at=0.3 force=3000,0,-9000"], duration_s=0.8, longest_s=1.5,
    ),
    "a force limit acts": Case("virtual", {**SOON, "limits": {"force_N": 7000, "force_step_N": 300}}, duration_s=0.8, longest_s=1.5),
    "reactions are torque off": Case(
        "virtual", {**SOON, "reactions": {"following": "sto", "silence": "damp"}},
        ["drive_gain leg=1 factor=0.3 mode=TRACKING at=0.2"], duration_s=0.8, longest_s=1.5,
    ),
}  # fmt: skip
