"""`hil run`: the start of its loop, and the effect of its end and of its plant."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.frame_array import NO_FRAMES
from drivers.signals import Fault, Mode
from hil.app.configuration.configuration import Configuration, load
from hil.app.run import command
from hil.loop.clock import RealTime
from hil.loop.daemon import Shell
from hil.loop.run_end import NO_DRIVES, Course, Ending
from hil.record import LogSummary
from tests.loop.test_run_end import cycle as a_cycle

PARKED = Ending(Mode.PARKED, Fault.NONE, "", 9)
STOPPED = Ending(Mode.FAULT, Fault.ESTOP, "latched fault ESTOP", 9)
VIRTUAL = load("virtual")
Ran = Callable[..., tuple[Course, Shell, list[int], dict[str, Any]]]


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Ran:
    """Run a loop of zero ticks on an idle bus; return course, shell, windows of bench time, and summary."""

    def run_daemon(
        c: Configuration = VIRTUAL, ending: Ending = PARKED, *, rate_Hz: float = 1000.0, plant_success: bool = True,
        unsaid: str = "", plant_trouble: str = "", plant_lives: bool = False, **options: Any,
    ) -> tuple[Course, Shell, list[int], dict[str, Any]]:  # fmt: skip
        begun: list[tuple[Course, Shell]] = []
        windows: list[int] = []
        watchdogs: list[float] = []
        clock = SimpleNamespace(now=lambda: 0, leave=lambda: None, interrupted=False)
        bus = SimpleNamespace(
            clock=clock, facts="", virtual=True, knows_ends=True, flush_tx=lambda: 0, drain_now=list
        )
        cycle: Any = a_cycle(Mode.WAITING)
        cycle.begin = lambda _: NO_FRAMES
        cycle.parts.trajectory, cycle.parts.law = SimpleNamespace(duration_s=1.0), None
        closed = LogSummary(tmp_path / "a.mcap", 0, 0, 0, 0, 0, 0.0, True, "", gave_up=False)
        recording = SimpleNamespace(event=lambda *_: None, close=lambda _: closed)
        found = "" if plant_lives else plant_trouble
        finished: dict[str, Any] = {"success": plant_success, "trouble": plant_trouble or None}
        plant = SimpleNamespace(trouble=lambda: found, finish=lambda: finished)
        keeper = SimpleNamespace(
            last_pose=None, begin=lambda _: None, close=lambda: None, summary=lambda _: {}, trouble=unsaid
        )

        def run(course: Course, shell: Shell) -> Ending:
            begun.append((course, shell))
            return ending

        def supervised(*given: Any) -> Any:
            watchdogs.append(given[-1])
            return contextlib.nullcontext(plant)

        def gives(it: Any) -> Any:
            return lambda *_, **__: it

        stand_ins = {
            "Bus": SimpleNamespace(open=gives(contextlib.nullcontext(bus))),
            "bench_clock": gives(clock), "begin": lambda *given: windows.append(given[-1]),
            "select_rate": gives((rate_Hz, 0.2)), "Keeper": gives(keeper), "build_cycle": gives(cycle),
            "make_room": gives([]), "needed_bytes": gives(0), "SupervisedPlant": supervised,
            "record": gives(contextlib.nullcontext(recording)),
            "OperatorChannel": gives(contextlib.nullcontext(None)),
            "real_time": gives(contextlib.nullcontext(RealTime())), "run": run, "law_figures": gives({}),
            "loads": gives({}),
        }  # fmt: skip
        for name, stand_in in stand_ins.items():
            monkeypatch.setattr(command, name, stand_in)
        summary = command.run_daemon(c, arm=True, log=tmp_path / "a.mcap", draw=False, **options)
        ((course, shell),) = begun
        assert watchdogs == [0.2] * bool(options.get("with_plant")), "watchdog of the actual loop rate"
        return course, shell, windows, summary

    return run_daemon


KINDS: list[dict[str, bool]] = [{}, {"with_plant": True}, {"on_bench": True}]
BUSES = pytest.mark.parametrize("options", KINDS, ids=["real", "plant", "bench"])


@BUSES
@pytest.mark.parametrize("goes_on", [False, True])
def test_run_continues_after_parking_or_a_fault_only_if_operator_stays_is_set(
    ran: Ran, options: dict[str, bool], goes_on: bool
) -> None:
    operator = VIRTUAL.operator.model_copy(update={"stays": goes_on})
    course, *_ = ran(VIRTUAL.model_copy(update={"operator": operator}), **options)
    assert (course.stays, course.goes_on) == (True, goes_on)


@BUSES
@pytest.mark.parametrize(
    ("rate_Hz", "window_ns"), [(1000.0, 750_000), (500.0, 1_500_000), (125.0, 6_000_000)]
)
def test_feedback_window_is_three_quarters_of_the_actual_loop_period(
    ran: Ran, options: dict[str, bool], rate_Hz: float, window_ns: int
) -> None:
    """Three quarters of a period; the configured rate is 1000 Hz."""
    assert VIRTUAL.loop.feedback_window_us is None
    _, shell, windows, _ = ran(rate_Hz=rate_Hz, **options)
    assert shell.feedback_window_ns == window_ns
    assert windows == ([window_ns] if options else [])
    assert shell.deadlines.period_ns == round(1e9 / rate_Hz)


@pytest.mark.parametrize("plant_success", [True, False])
@pytest.mark.parametrize("ending", [PARKED, STOPPED], ids=["parked", "stopped"])
def test_run_with_a_plant_succeeds_only_if_both_succeed(
    ran: Ran, ending: Ending, plant_success: bool
) -> None:
    *_, summary = ran(ending=ending, plant_success=plant_success, with_plant=True)
    assert summary["success"] is (ending is PARKED and plant_success)
    assert summary["plant"]["success"] is plant_success


@pytest.mark.parametrize("ending", [PARKED, STOPPED], ids=["parked", "stopped"])
def test_dead_plant_is_reported_before_the_controller_fault(ran: Ran, ending: Ending) -> None:
    died = "the plant, process 7, was killed by SIGKILL"
    *_, summary = ran(ending=ending, plant_success=False, plant_trouble=died, with_plant=True)
    assert summary["success"] is False
    seen = f"; the controller: {ending.reason}" if ending.reason else ""
    assert summary["trouble"] == died + seen


@pytest.mark.parametrize(
    ("ending", "seen"),
    [
        (Ending(Mode.FAULT, Fault.STALE, "latched fault STALE", 9), "latched fault STALE"),
        (Ending(Mode.FAULT, Fault.STALE | Fault.ESTOP, "latched fault ESTOP", 9), "latched fault ESTOP"),
        (Ending(Mode.WAITING, Fault.NONE, NO_DRIVES, 9), "no drive answered on "),
        (STOPPED, None),
        (PARKED, None),
    ],
    ids=["stale", "stale and stopped", "no drives", "stopped", "parked"],
)
def test_failed_plant_is_reported_as_the_cause_of_silent_legs(
    ran: Ran, ending: Ending, seen: str | None
) -> None:
    why = "my.fmu: the FMU did not step within 5 s"
    *_, summary = ran(
        ending=ending, plant_success=False, plant_trouble=why, plant_lives=True, with_plant=True
    )
    assert summary["plant"]["trouble"] == why
    if seen is None:
        assert summary["trouble"] == (ending.reason or None)
    else:
        assert summary["trouble"].startswith(f"{why}; the controller: {seen}")


def test_run_that_cannot_write_its_homing_file_fails(
    ran: Ran,
) -> None:
    *_, summary = ran(unsaid="lab.yaml: cannot be written")
    assert (summary["success"], summary["trouble"]) == (False, "lab.yaml: cannot be written")
    *_, summary = ran(ending=STOPPED, unsaid="lab.yaml: cannot be written")
    assert summary["trouble"] == "latched fault ESTOP; lab.yaml: cannot be written"
