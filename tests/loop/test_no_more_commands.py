"""End of a simulation that waits for more commands than it gets: STOP, parked, or the end of its duration."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.signals import Fault, Mode
from hil.loop.console import REFUSED
from hil.loop.run_end import LEFT_ALONE, Course
from hil.signals import Operator
from tests.broad import broad
from tests.loop.operator_runs import modes, simulated
from tests.loop.test_run_end import cycle

MOVING = (Mode.APPROACH, Mode.TRACKING)
STOP = (Operator.STOP,)
PARKED = ["PARKING", "UNLOADING", "PARKED"]


def waiting(mode: Mode, *, go: bool = True, speed: float = 1.0, parks: bool = False, **more: Any) -> Any:
    now = cycle(mode, **more)
    now.operating = SimpleNamespace(
        trouble="", go=go, speed=speed, moves=lambda mode: mode in MOVING or (mode is Mode.STOPPING and parks)
    )
    return now


@pytest.mark.parametrize(
    ("now", "stops"),
    [
        *[(waiting(mode, go=False), True) for mode in MOVING],
        *[(waiting(mode, speed=0.0), True) for mode in MOVING],
        *[(waiting(mode, speed=0.01), False) for mode in MOVING],
        (waiting(Mode.STOPPING, go=False, parks=True), True),
        (waiting(Mode.STOPPING, parks=True), False),
        (waiting(Mode.STOPPING, go=False), False),
        *[(waiting(mode, go=False), False) for mode in (Mode.WAITING, Mode.LOADING, Mode.PARKING, Mode.HELD)],
        (waiting(Mode.IDLE), False),
    ],
)
def test_simulation_that_pauses_on_its_path_after_its_last_command_is_stopped(now: Any, stops: bool) -> None:
    told: list[str] = []
    course = Course(now, event=lambda _t, _level, text: told.append(text))
    for _ in range(3):
        assert course.left_alone() == (STOP if stops else ())
    assert told == [LEFT_ALONE] * stops, "once"


def test_simulation_that_waits_for_arm_is_stopped_after_its_last_command() -> None:
    assert Course(waiting(Mode.IDLE), armed=False).left_alone() == STOP
    course = Course(waiting(Mode.IDLE))
    assert course.left_alone() == ()
    assert course.commands(0) == (Operator.ENGAGE,)
    assert course.left_alone() == STOP, "after a reset it would wait for a new `arm`"


@pytest.mark.parametrize("mode", [Mode.PARKED, Mode.FAULT])
def test_simulation_set_to_stay_after_parking_ends_after_its_last_command(mode: Mode) -> None:
    faults = Fault.ESTOP if mode is Mode.FAULT else Fault.NONE
    course = Course(waiting(mode, faults=faults), goes_on=True)
    assert course.ending(2000) is None
    assert course.left_alone() == ()
    assert course.ending(2001) is not None


@pytest.mark.parametrize(
    ("commands", "operator", "last"),
    broad(
        [
            ([(0.3, "arm"), (0.4, "estop")], {"stays": True}, ["LOADING", "FAULT"]),
            ([(1.3, "hold")], {}, ["TRACKING", "STOPPING", *PARKED]),
            ([(0.1, "speed 50")], {"start": "asked"}, ["TRACKING", "STOPPING", *PARKED]),
            ([(0.0, "key")], {"deadman_s": 0.1}, ["APPROACH", "STOPPING", *PARKED]),
        ],
        quick=2,
    ),
)
def test_simulation_ends_although_its_last_command_leaves_the_run_waiting(tmp_path, commands, operator, last):
    run, rows = simulated(tmp_path, commands, operator=operator)
    assert run.success == (last[-1] == "PARKED")
    assert modes(rows)[-len(last) :] == last
    assert rows["tick"][-1] < 5000


def test_simulation_with_commands_before_its_drives_are_ready_ends_and_logs_each_refusal(tmp_path):
    commands = [
        *[(0.0, "arm"), (0.0, "speed 50"), (0.001, "start"), (0.002, "jog x 1 for 0.03")],
        *[(0.003, "setpoint 0 0 1"), (0.003, "release"), (0.004, "reset")],
    ]
    run, rows = simulated(tmp_path, commands, check_replay=False)
    assert run.success
    assert modes(rows) == ["WAITING", "IDLE", "PARKED"]
    assert run.summary["commands"] == {"given": 7, "refused": 5, "not_reached": 0}
    told = [event for event in run.log.events() if event.text.startswith(REFUSED)]
    assert {event.level for event in told} == {"warning"}
    for n, (event, word) in enumerate(zip(told, ("arm", "moving", "hold", "nothing is held"), strict=True)):
        assert event.t_ns // 1_000_000 == n
        assert word in event.text
