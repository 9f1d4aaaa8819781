"""What one step hands from stage to stage, and what of it the row says."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.arrays import ZERO6, array_at
from drivers.frame_array import FRAME, sent_array, sent_frames
from drivers.protocol import Frame, Received
from drivers.signals import DriveMode, Fault, Mode, Warn
from hil.app.compose import build_cycle
from hil.estimation.external_wrench import ExternalWrench
from hil.loop import cycle as cycle_module
from hil.loop.admission import Counts
from hil.loop.cycle import Cycle
from hil.loop.homing import LastPose
from hil.robot.kinematics import leg_lengths
from hil.signals import Operator, Order, SetPoint
from tests.drivers.legs_frames import opening
from tests.drivers.stub_protocol import InPython
from tests.hil.test_cycle import Bench, held_to
from tests.hil.test_cycle_again import LIVE, VIRTUAL
from tests.hil.test_cycle_held import aside

ASKED = np.array([11.0, -12.0, 13.0, -14.0, 15.0, -16.0])
LENIENT = VIRTUAL.limits.model_copy(update={"following_error_m": 10.0})


class Law:
    """Asks for the same always. State: the shortfall that it saw last."""

    shortfall = ZERO6

    def reset(self) -> None:
        """Nothing is kept."""

    def effort(self, tick: Any) -> None:
        self.shortfall = tick["shortfall"].copy()
        tick["tau_law"] = ASKED


def staying(bench: Bench) -> Bench:
    """Return a bench that is about to begin tick 50, and stays in its mode."""
    for _ in range(50):
        bench.step()
    bench.cycle._change_mode = lambda *_: None  # type: ignore[method-assign]
    return bench


def a_bench(**parts: Any) -> Bench:
    """Return such a bench, with a live reference and a law that asks for the same always."""
    c = VIRTUAL.model_copy(update={"reference": LIVE, "limits": LENIENT})
    made = build_cycle(c, 1000.0, 0.01).parts
    return staying(Bench(cycle=Cycle(replace(made, **{"law": Law()} | parts))))


@pytest.fixture
def bench() -> Bench:
    return a_bench()


def step(bench: Bench, mode: Mode, operator: tuple[Operator, ...] = (), **changes: Any) -> Any:
    """Return the row of the next tick, which is in a mode."""
    bench.cycle.mode = mode
    bench.cycle.control.settle()
    return bench.step(operator, **changes).row


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING])
@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize("what", ["goes", "on hold", "parks"])
def test_a_live_reference_takes_set_points_where_it_may_go(bench, monkeypatch, mode, elsewhere, what):
    told: list[Any] = []
    cycle = bench.cycle
    steering: Any = cycle.parts.steering
    monkeypatch.setattr(steering, "take", lambda points, *, tracking: told.append(tracking))
    if elsewhere:
        cycle.motion.rest(aside(cycle), cycle.parts.home_R, 20)
    else:
        cycle.motion.start(cycle.parts.trajectory, 20)
    cycle.operating.go, cycle.operating.parks = what != "on hold", what == "parks"
    step(bench, mode, setpoints=(SetPoint(0.0, 0.0, 1.0, 0.0, 0.0, 0.0),))
    assert told == [mode is Mode.TRACKING and what == "goes"]


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING])
@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_live_reference_goes_on_where_it_is_under_way_alone(bench, mode, elsewhere):
    cycle = bench.cycle
    live = cycle.parts.steering.trajectory
    live.reset()
    if elsewhere:
        cycle.motion.rest(aside(cycle), cycle.parts.home_R, 20)
    else:
        cycle.motion.start(live, 20)
    cycle.operating.go = True
    step(bench, mode)
    under_way = mode in {Mode.TRACKING, Mode.STOPPING} and not elsewhere
    assert int(live._live["tick"]) == (30 if under_way else 0)


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING])
@pytest.mark.parametrize("away", [False, True])
def test_the_time_along_the_reference_is_told_to_the_law_only_on_it_and_to_the_log_always(bench, mode, away):
    cycle = bench.cycle
    cycle.motion.rest(aside(cycle), cycle.parts.home_R, 20)
    if away:
        cycle.motion._left = cycle.parts.trajectory, 0.0
    row = step(bench, mode)
    assert row["reference_time_s"] == pytest.approx(0.03)
    np.testing.assert_array_equal(row["p_d"], aside(cycle))
    if mode is Mode.TRACKING and not away:
        assert cycle.tick["t_d"] == row["reference_time_s"]
    else:
        assert np.isnan(cycle.tick["t_d"])


@pytest.mark.parametrize("mode", list(Mode))
def test_the_reference_is_where_the_motion_is_as_long_as_legs_must_follow_it_and_else_where_they_are(
    bench, mode
):
    cycle = bench.cycle
    cycle.motion.rest(aside(cycle), cycle.parts.home_R, 20)
    row = step(bench, mode)
    follows = mode not in {Mode.WAITING, Mode.IDLE, Mode.LOADING, Mode.PARKED, Mode.FAULT}
    np.testing.assert_array_equal(row["p_d"], aside(cycle) if follows else row["p"])


@pytest.mark.parametrize(
    ("mode", "limit_N", "limited"),
    [
        (Mode.TRACKING, 10.0, True),
        (Mode.HELD, 10.0, True),
        (Mode.TRACKING, 100.0, False),
        (Mode.LOADING, 10.0, False),
    ],
)
def test_what_the_limits_took_of_a_force_is_kept_for_the_law_while_it_acts(bench, mode, limit_N, limited):
    cycle = bench.cycle
    cycle.effort.holding, cycle.mode_tick = ASKED, -100_000
    with held_to(bench, force_N=limit_N):
        warnings = int(step(bench, mode)["warnings"])
    assert bool(warnings & Warn.FORCE_LIMIT) == (limit_N < 11.0)
    step(bench, Mode.TRACKING)
    kept = np.clip(ASKED, -limit_N, limit_N) - ASKED if limited else ZERO6
    np.testing.assert_array_equal(cycle.parts.law.shortfall, kept)
    cycle.reset()
    assert not cycle.control.record["shortfall"].any()


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("refusal", [0, 4])
def test_the_row_has_what_safety_warns_of_and_beside_it_silent_sensors_and_refused_set_points(
    monkeypatch, late, refusal
):
    bench = a_bench(wrench=ExternalWrench(None, 1000.0 if late else None, 1e-3))
    steering: Any = bench.cycle.parts.steering
    monkeypatch.setattr(steering, "take", lambda *_, **__: None)
    steering.counts = Counts(7, 9, refusal)
    bench.drives.silent = {2}
    for _ in range(2):
        row = step(bench, Mode.TRACKING)
    expected = Warn.STALE | (Warn.SENSOR if late else Warn.NONE) | (Warn.SETPOINT if refusal else Warn.NONE)
    assert Warn(int(row["warnings"])) == expected
    assert [int(row[name]) for name in ("setpoints_taken", "setpoints_refused", "setpoint_refusal")] == [
        *(7, 9, refusal)
    ]


def test_the_row_has_the_mode_and_the_faults_that_the_tick_has_led_to(bench):
    row = step(bench, Mode.TRACKING, bus_off=True)
    assert (Mode(int(row["mode"])), Fault(int(row["faults"]))) == (Mode.FAULT, Fault.BUS)
    assert not row["tau"].any()


def test_a_tick_begins_with_what_the_dialogue_asks_for_in_it(bench):
    cycle = bench.cycle
    for number in (7, 300):
        assert sent_frames(cycle.begin(number)) == opening(cycle.parts.protocol, number)


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("proven", [False, True])
def test_a_leg_whose_drive_was_off_is_known_to_be_braked_in_any_mode_by_the_last_test_of_the_brakes_alone(
    mode, proven
):
    parts = build_cycle(VIRTUAL, 1000.0, 0.01).parts
    length, step_m = leg_lengths(parts.platform, parts.home_p, parts.home_R), np.full(6, 0.01)
    bench = a_bench(last_pose=LastPose(length, step_m, step_m, step_m, "parked", "hil homing"))
    bench.cycle.proven = proven
    bench.drives.length = length - step_m * (np.arange(6) == 4)
    step(bench, mode)
    assert bench.cycle.homing.known == proven
    assert bool(bench.cycle.homing.refusal) != proven
    assert (bench.cycle.tick["length"][4] == pytest.approx(length[4], abs=1e-6)) == proven


def test_the_operators_orders_of_a_tick_are_taken_before_its_mode_is_chosen(bench, monkeypatch):
    told: list[Any] = []
    cycle = bench.cycle
    monkeypatch.setattr(cycle.operating, "step", lambda *what: told.append(what))
    monkeypatch.setattr(cycle, "_change_mode", lambda *what: told.append(what))
    orders = (Order(Operator.HOLD),)
    step(bench, Mode.TRACKING, orders=orders)
    (ordered, (inp, tick)) = told
    assert ordered == (orders, 50, Mode.TRACKING, cycle.motion)
    assert inp.orders == orders
    assert tick is cycle.tick


STOP, COMMAND, SET_UP = (Frame(identifier, b"\1") for identifier in (0x7A1, 0x7A2, 0x7A3))


@pytest.fixture
def spoken(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return such a bench, whose family sends these frames, and what that is told of a stop."""
    family = copy(build_cycle(VIRTUAL, 1000.0, 0.01).parts.protocol)
    family.traits = replace(family.traits, emergency_stop=(STOP,))
    bench = a_bench(protocol=family)
    told: list[Any] = []

    def command(_codec: int, number: int, mode: int, stop: int, _force: int, into: int) -> int:
        told.append((bool(stop), mode, number))
        array_at(into, 1, FRAME)[:] = sent_array((COMMAND,))
        return 1

    commands = InPython(command, 6)
    bench.cycle.control.record["command"] = commands.address
    monkeypatch.setattr(bench.cycle.end, "set_up", lambda _tick: sent_array((SET_UP,)))
    yield bench, told
    del commands


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
    spoken, monkeypatch, what, told_last, stops, sent
):
    (bench, told), asked = spoken, list[Any]()
    cycle = bench.cycle
    family: Any = cycle.parts.protocol
    family.traits = replace(family.traits, stop_latches="latches" in what)
    monkeypatch.setattr(
        cycle_module,
        "confirmed",
        lambda *args: asked.append(args) or "confirmed" in what,  # type: ignore[func-returns-value]
    )
    cycle.estop = "asked" in what
    cycle.faults = Fault.SECOND_CONTROLLER if "rivals" in what else Fault.DRIVE
    cycle.tick["command_mode"] = told_last
    cycle.mode = Mode.FAULT
    cycle.control.settle()
    frames = bench.step((Operator.STOP, Operator.ESTOP) if "said" in what else ()).frames
    assert sent_frames(frames) == (*(STOP,) * sent, COMMAND, SET_UP)
    assert told == [(stops, DriveMode.OFF, 50)]
    assert asked == [(cycle.tick, "latches" in what)] * ("asked" in what)


@pytest.mark.parametrize("identifier", [0x001, 0x080])
def test_the_stop_of_another_node_or_a_second_controller_is_answered_in_the_tick_in_which_it_is_found(
    spoken, identifier
):
    bench, told = spoken
    bench.cycle.mode = Mode.TRACKING
    bench.cycle.control.settle()
    assert sent_frames(bench.step().frames) == (COMMAND,)
    heard = (*bench.drives.feedback(51), Received(51_300_000, Frame(identifier, b"\1\2")))
    assert sent_frames(bench.step(frames=heard).frames)[:2] == (STOP, COMMAND)
    assert [each[:2] for each in told] == [(False, DriveMode.RUN), (True, DriveMode.OFF)]
