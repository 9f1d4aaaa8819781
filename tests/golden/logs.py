"""The frozen logs of tests/data/golden_logs, with the settings of each.

python -m tests.golden.logs     # makes the missing ones; an existing log is never made again
"""

from __future__ import annotations

import os
from pathlib import Path

import hil
from tests.golden.cases import ASKED, CASES, FUSED, KEY, LAWS, STAYS
from tests.golden.fault_cases import SOON, STILL, Changes
from tests.golden.runner import CONFIGS, Case
from tools.drive_families import FAMILIES, merged

FOLDER = Path(__file__).parents[1] / "data" / "golden_logs"
BRIEF: Changes = merged(SOON, {"engage": {"blend_s": 0.05, "stop_s": 0.1, "brake_close_s": 0.05}})
"""Short runs and slow loops keep the logs small."""
SLOW: Changes = merged(BRIEF, {"loop": {"rate_Hz": 250}, "drives": {"watchdog_ms": 16}})
TRACKING = "mode=TRACKING at=0.05"


def of_family(name: str) -> Case:
    return Case("desktop", merged(SLOW, FAMILIES[name]), duration_s=0.6)


def of_law(name: str, changes: Changes = SLOW) -> Case:
    return Case("virtual", merged(LAWS[name], changes), duration_s=0.3)


def of_fault(words: str, changes: Changes = SLOW, configuration: str = "virtual") -> Case:
    return Case(configuration, changes, [words], duration_s=0.35)


TWO: Changes = merged(
    BRIEF, {"loop": {"rate_Hz": 250, "feedback_window_us": None}, "drives": {"watchdog_ms": 16}}
)
LOGS: dict[str, Case] = {
    "legs-fd": Case("virtual", SLOW, duration_s=0.3),
    "legs-classic": of_family("legs, classic"),
    "ideal": Case("ideal", {"loop": {"rate_Hz": 250}, "drives": {"watchdog_ms": 16}}, duration_s=0.2),
    "bench": Case("bench", merged(SLOW, {"engage": {"stop_s": 0.4, "blend_s": 0.3}}), duration_s=0.6),
    "vcan50": Case("vcan50", duration_s=3.0),
    "cia402-difference": Case("virtual-cia402", BRIEF, duration_s=0.6),
    "cia402-pdo": of_family("cia402, pdo")._replace(duration_s=0.8),
    "mit-damiao": of_family("mit, damiao DM4310"),
    "mit-mini-cheetah": of_family("mit, mini_cheetah"),
    "mit-robstride": of_family("mit, robstride rs-02"),
    "odrive": of_family("odrive")._replace(duration_s=0.4),
    "moteus": of_family("moteus"),
    "homing": CASES["drives that forget their turns"]._replace(
        changes=merged(SLOW, CASES["drives that forget their turns"].changes), duration_s=0.7
    ),
    "law-pid": of_law("pid"),
    "law-feedforward-offline": of_law("feedforward_pd offline"),
    "law-sliding-mode": of_law("sliding_mode"),
    "law-state-space": of_law("state_space hinf", merged(BRIEF, {"engage": {"force_ramp_s": 0.02, "blend_s": 0.02, "stop_s": 0.05}}))._replace(duration_s=0.12),
    "law-pose-with-delay-compensation": of_law("inverse_dynamics with delay_compensation"),
    "law-cartesian-pd": of_law("cartesian_pd shortest turn"),
    "two-buses": Case("two_buses", TWO, duration_s=0.4),
    "two-buses-bus-off": of_fault(f"bus_off bus=1 {TRACKING}", TWO, "two_buses"),
    "fused": Case("virtual", merged(FUSED, SLOW), [f"encoder_lost leg=1 {TRACKING}"], duration_s=0.3),
    "encoder-jump": of_fault(f"encoder_jump leg=2 by=0.005 {TRACKING}"),
    "frames-lost": of_fault(f"frames_loss probability=0.2 for=0.1 {TRACKING}"),
    "brake-stuck-open-at-hold": of_fault("brake_stuck_open leg=2 mode=HOLD", merged(STILL, SLOW)),
    "second-controller-while-loading": of_fault("frames_forged_command force=3000 mode=LOADING"),
    "emergency-stop": Case("virtual", SLOW, commands=[(0.3, "estop")]),
    "reset-and-second-start": Case(
        "virtual",
        merged(STAYS, SLOW),
        commands=[(0.1, "arm"), (0.35, "estop"), (0.7, "reset"), (0.8, "arm"), (0.9, "start"), (1.2, "stop")],
        duration_s=1.6,
    ),
    "jog-speed-and-park": Case(
        "virtual",
        merged(ASKED, SLOW),
        commands=[(0.3, "jog x 1 for 0.15"), (0.6, "start"), (0.65, "speed 40"), (0.9, "park")],
        duration_s=1.2,
    ),
    "dead-mans-key": Case(
        "virtual", merged(KEY, SLOW, {"engage": {"stop_s": 0.3}}), commands=[(0.0, "key for 0.3"), (0.6, "key for 0.2"), (0.65, "start")], duration_s=0.75
    ),
}  # fmt: skip
QUICK = ("vcan50", "emergency-stop", "two-buses-bus-off")
"""Logs replayed in the normal suite."""


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name, case in LOGS.items():
        path = FOLDER / f"{name}.mcap"
        if not path.exists():
            run = hil.sim(
                os.path.relpath(
                    CONFIGS / f"{case.configuration}.yaml"
                ),  # no log names a folder of this machine
                log=path,
                duration_s=case.duration_s,
                plant_log=False,
                faults=case.faults,
                commands=case.commands,
                **case.changes,
            )
            assert run.summary["replay"]["exact"], run.summary["replay"]
            assert not {"mode_not_reached", "time_not_reached"} & set(run.summary), run.summary
            print(
                f"{path.stat().st_size:7d} bytes  {run.summary['trouble'] or 'parked':.70}  {name}",
                flush=True,
            )


if __name__ == "__main__":
    main()
