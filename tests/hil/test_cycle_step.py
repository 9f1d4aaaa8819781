"""What one step hands from stage to stage, and what of it the row says."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.arrays import ZERO6
from drivers.signals import DriveMode, Fault, Mode, Stop, Warn
from hil.app.compose import build_cycle
from hil.loop import cycle as cycle_module
from hil.loop.cycle import Cycle
from hil.loop.steering import Counts
from hil.safety.guard import Verdict
from hil.signals import Operator, Order, TickInput
from tests.hil.test_cycle_again import LIVE, VIRTUAL
from tests.hil.test_cycle_held import LAST, aside

ASKED = np.array([11.0, -12.0, 13.0, -14.0, 15.0, -16.0])


@pytest.fixture(scope="module")
def made() -> Cycle:
    return build_cycle(VIRTUAL.model_copy(update={"reference": LIVE}), 1000.0, 0.01)


@pytest.fixture
def cycle(made: Cycle, monkeypatch: pytest.MonkeyPatch) -> Cycle:
    """A cycle that stays in its mode, asks for a force, and is judged well."""
    made.reset()
    monkeypatch.setattr(made, "_change_mode", lambda *_: None)

    def fill(tick: Any, *_: Any, **__: Any) -> None:
        tick["tau_asked"] = ASKED

    monkeypatch.setattr(made.effort, "fill", fill)
    judged(made, monkeypatch)
    return made


def judged(
    cycle: Cycle,
    monkeypatch: pytest.MonkeyPatch,
    warnings: Warn = Warn.NONE,
    faults: Fault = Fault.NONE,
    share: float = 1.0,
) -> list[Any]:
    """Let safety find this, and leave a share of the force; return the ticks that it sees."""
    seen: list[Any] = []

    def judge(tick: Any) -> Verdict:
        seen.append((int(tick["mode"]), tick["tau_asked"].copy()))
        tick["tau"] = share * tick["tau_asked"]
        return Verdict(warnings, faults, Stop.NONE)

    monkeypatch.setattr(cycle.parts.safety, "judge", judge)
    return seen


def step(cycle: Cycle, number: int = 50, **changes: Any) -> Any:
    return cycle.step(TickInput(number, 1_000_000 * number, **changes)).row


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING])
@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize("what", ["goes", "on hold", "parks"])
def test_a_live_reference_moves_on_its_own_way_alone_and_takes_set_points_where_it_may_go(
    cycle, monkeypatch, mode, elsewhere, what
):
    told: list[Any] = []
    steering: Any = cycle.parts.steering
    monkeypatch.setattr(steering, "step", lambda points, along, *, tracking: told.append((along, tracking)))
    cycle.mode = mode
    if elsewhere:
        cycle.motion.rest(aside(cycle), cycle.parts.home_R, 20)
    else:
        cycle.motion.start(cycle.parts.trajectory, 20)
    cycle.operating.go, cycle.operating.parks = what != "on hold", what == "parks"
    step(cycle)
    under_way = mode in {Mode.TRACKING, Mode.STOPPING} and not elsewhere
    assert told == [(30 if under_way else None, mode is Mode.TRACKING and what == "goes")]


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING])
@pytest.mark.parametrize("away", [False, True])
def test_the_time_along_the_reference_is_told_to_the_law_only_on_it_and_to_the_log_always(cycle, mode, away):
    cycle.mode = mode
    cycle.motion.rest(aside(cycle), cycle.parts.home_R, 20)
    if away:
        cycle.motion._left = cycle.parts.trajectory, 0.0
    row = step(cycle)
    assert row["reference_time_s"] == pytest.approx(0.03)
    np.testing.assert_array_equal(row["p_d"], aside(cycle))
    if mode is Mode.TRACKING and not away:
        assert cycle.tick["t_d"] == row["reference_time_s"]
    else:
        assert np.isnan(cycle.tick["t_d"])


@pytest.mark.parametrize("mode", list(Mode))
def test_the_reference_is_where_the_motion_is_as_long_as_legs_must_follow_it_and_else_where_they_are(
    cycle, mode
):
    cycle.mode = mode
    cycle.motion.rest(aside(cycle), cycle.parts.home_R, 20)
    row = step(cycle)
    follows = mode not in {Mode.WAITING, Mode.IDLE, Mode.LOADING, Mode.PARKED, Mode.FAULT}
    np.testing.assert_array_equal(row["p_d"], aside(cycle) if follows else cycle.parts.home_p)


@pytest.mark.parametrize("mode", list(Mode))
def test_safety_judges_the_force_that_is_asked_for_in_the_mode_of_this_tick(cycle, monkeypatch, mode):
    seen = judged(cycle, monkeypatch)
    cycle.mode = mode
    step(cycle)
    assert seen[0][0] == mode
    np.testing.assert_array_equal(seen[0][1], ASKED)


@pytest.mark.parametrize(
    ("mode", "warnings", "limited"),
    [
        (Mode.TRACKING, Warn.FORCE_STEP, True),
        (Mode.HELD, Warn.FORCE_LIMIT, True),
        (Mode.TRACKING, Warn.NONE, False),
        (Mode.LOADING, Warn.FORCE_LIMIT, False),
    ],
)
def test_what_the_limits_took_of_a_force_is_kept_for_the_law_while_it_acts(
    cycle, monkeypatch, mode, warnings, limited
):
    judged(cycle, monkeypatch, warnings, share=0.5)
    cycle.mode, cycle.effort.shortfall = mode, LAST
    step(cycle)
    if limited:
        np.testing.assert_array_equal(cycle.effort.shortfall, -0.5 * ASKED)
    else:
        assert cycle.effort.shortfall is ZERO6


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("refusal", [0, 4])
def test_the_row_has_what_safety_warns_of_and_beside_it_silent_sensors_and_refused_set_points(
    cycle, monkeypatch, late, refusal
):
    judged(cycle, monkeypatch, Warn.STALE)
    wrench = SimpleNamespace(late=late, fill=lambda *_, **__: None)
    monkeypatch.setattr(cycle, "parts", replace(cycle.parts, wrench=wrench))
    steering: Any = cycle.parts.steering
    monkeypatch.setattr(steering, "step", lambda *_, **__: None)
    steering.counts = Counts(7, 9, refusal)
    row = step(cycle)
    expected = Warn.STALE | (Warn.SENSOR if late else Warn.NONE) | (Warn.SETPOINT if refusal else Warn.NONE)
    assert Warn(int(row["warnings"])) == expected
    assert [int(row[name]) for name in ("setpoints_taken", "setpoints_refused", "setpoint_refusal")] == [
        *(7, 9, refusal)
    ]


def test_the_row_has_the_mode_and_the_faults_that_the_tick_has_led_to(cycle, monkeypatch):
    judged(cycle, monkeypatch, faults=Fault.BUS)
    cycle.mode = Mode.TRACKING
    row = step(cycle)
    assert (Mode(int(row["mode"])), Fault(int(row["faults"]))) == (Mode.FAULT, Fault.BUS)
    assert not row["tau"].any()


def test_a_tick_begins_with_what_the_dialogue_asks_for_in_it(cycle, monkeypatch):
    monkeypatch.setattr(cycle.parts.protocol, "begin", lambda *asked: asked)
    assert cycle.begin(7) == (cycle.dialogue, 7)


@pytest.mark.parametrize("sensors", [None, "the sensors"])
def test_sensors_are_heard_before_the_pose_is_estimated_as_of_the_first_latch_and_the_load_after_it(
    cycle, monkeypatch, sensors
):
    told: list[Any] = []
    last = cycle.tick
    wrench = SimpleNamespace(late=False, fill=lambda tick, *, fusing: told.append(("load", tick, fusing)))
    monkeypatch.setattr(cycle, "parts", replace(cycle.parts, wrench=wrench, sensors=sensors))
    monkeypatch.setattr(cycle.sight, "hear", lambda *what: told.append(("heard", *what)))
    monkeypatch.setattr(cycle.sight, "estimate", lambda *what: told.append(("pose", *what)))
    monkeypatch.setattr(cycle.sight, "fusing", True)
    inp = TickInput(50, 50_000_000, 300, latch_ns=(0, 9, 7, 8, 0, 9))
    cycle.step(inp)
    tick = cycle.tick
    assert tick is not last
    heard = [("heard", sensors, inp, tick)] if sensors else []
    assert told == [*heard, ("pose", tick, last, 50_000_307), ("load", tick, True)]


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("proven", [False, True])
def test_a_leg_whose_drive_was_off_is_known_to_be_braked_in_any_mode_by_the_last_test_of_the_brakes_alone(
    cycle, monkeypatch, mode, proven
):
    told: list[Any] = []
    monkeypatch.setattr(cycle.homing, "correct", lambda *what, braked: told.append((*what, braked)))
    last, cycle.mode, cycle.proven = cycle.tick, mode, proven
    step(cycle)
    assert told == [(cycle.tick, last, proven)]


def test_the_operators_orders_of_a_tick_are_taken_before_its_mode_is_chosen(cycle, monkeypatch):
    told: list[Any] = []
    monkeypatch.setattr(cycle.operating, "step", lambda *what: told.append(what))
    monkeypatch.setattr(cycle, "_change_mode", lambda *what: told.append(what))
    cycle.mode, orders = Mode.TRACKING, (Order(Operator.HOLD),)
    inp = TickInput(50, 50_000_000, orders=orders)
    cycle.step(inp)
    assert told == [(orders, 50, Mode.TRACKING, cycle.motion), (inp, cycle.tick)]


@pytest.mark.parametrize(
    ("what", "told_last", "stops", "sent"),
    [
        ({"said"}, DriveMode.RUN, True, True),
        ({"said"}, DriveMode.OFF, True, False),
        ({"said", "latches"}, DriveMode.OFF, True, True),
        ({"said", "rivals"}, DriveMode.OFF, True, True),
        ({"said", "confirmed"}, DriveMode.RUN, True, True),
        ({"asked", "latches"}, DriveMode.OFF, True, True),
        ({"asked"}, DriveMode.READY, True, True),
        ({"asked", "latches", "confirmed"}, DriveMode.RUN, False, False),
        ({"latches"}, DriveMode.RUN, False, False),
        ({"rivals", "latches", "confirmed"}, DriveMode.RUN, False, False),
    ],
)
def test_an_emergency_stop_goes_out_first_until_it_is_confirmed_unless_off_alone_is_the_stop(
    cycle, monkeypatch, what, told_last, stops, sent
):
    protocol, told, asked = cycle.parts.protocol, list[Any](), list[Any]()

    def command(dialogue: Any, command: Any, number: int) -> Any:
        told.append((command.stop, command.mode, number))
        return dialogue, ("command",)

    monkeypatch.setattr(type(protocol), "stop_latches", "latches" in what)
    monkeypatch.setattr(protocol, "command", command)
    monkeypatch.setattr(protocol, "emergency_stop", lambda: ("stop",))
    monkeypatch.setattr(protocol, "set_up", lambda dialogue, _tick: (dialogue, ("set-up",)))
    monkeypatch.setattr(
        cycle_module,
        "confirmed",
        lambda *args: asked.append(args) or "confirmed" in what,  # type: ignore[func-returns-value]
    )
    cycle.mode, cycle.estop = Mode.FAULT, "asked" in what
    cycle.faults = Fault.SECOND_CONTROLLER if "rivals" in what else Fault.DRIVE
    cycle.tick["command_mode"] = told_last
    operator = (Operator.STOP, Operator.ESTOP) if "said" in what else ()
    frames = cycle.step(TickInput(50, 50_000_000, operator=operator)).frames
    assert frames == (*("stop",) * sent, "command", "set-up")
    assert told == [(stops, DriveMode.OFF, 50)]
    assert asked == [(cycle.tick, "latches" in what)] * ("asked" in what)


@pytest.mark.parametrize("fault", [Fault.ESTOP, Fault.SECOND_CONTROLLER])
def test_the_stop_of_another_node_or_a_second_controller_is_answered_in_the_tick_in_which_it_is_found(
    cycle, monkeypatch, fault
):
    protocol, told = cycle.parts.protocol, list[Any]()

    def command(dialogue: Any, command: Any, _tick: int) -> Any:
        told.append((command.stop, command.mode))
        return dialogue, ("command",)

    monkeypatch.setattr(protocol, "command", command)
    monkeypatch.setattr(protocol, "emergency_stop", lambda: ("stop",))
    cycle.mode = Mode.TRACKING
    cycle.tick["command_mode"] = DriveMode.RUN
    assert cycle.step(TickInput(50, 50_000_000)).frames == ("command",)
    judged(cycle, monkeypatch, faults=fault)
    assert cycle.step(TickInput(51, 51_000_000)).frames[:2] == ("stop", "command")
    assert told == [(False, DriveMode.RUN), (True, DriveMode.OFF)]
