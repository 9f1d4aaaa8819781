"""How a run begins and ends: the rule itself, and that the daemon and the lockstep keep to the same one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from drivers.protocol import DriveSetup, Received
from drivers.signals import NEVER, BusState, DriveState, Fault, Mode, Reaction, Stop
from drivers.tick_columns import FIRST
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import load
from hil.app.sim.lockstep import Lockstep
from hil.loop.daemon import Shell, run
from hil.loop.modes import Durations
from hil.loop.panel import OperatorPanel
from hil.loop.run_end import Course, Ending
from hil.signals import Operator
from plant_fmu.faults.drive import DriveSilence
from plant_fmu.faults.encoder import EncoderJump
from plant_fmu.faults.frames import FramesLoss
from plant_fmu.faults.plan import FaultPlan
from tests.records import altered, record_of

RATE_Hz = 100.0
SET_UP = SimpleNamespace(
    set_up_lacks=lambda _: ("",) * 6,
    fault_text=lambda _: "",
    stop_latches=True,
    force_on_brakes=True,
    has_watchdog=True,
)
HEARD = {"age": 0, "counted_age": 0, "drive_state": DriveState.OFF}


def cycle(mode, mode_tick=0, faults=Fault.NONE, stop=Stop.NONE, **measured):
    return SimpleNamespace(
        mode=mode,
        mode_tick=mode_tick,
        faults=faults,
        stop_requested=stop,
        proven=True,
        tick=record_of(**(HEARD | measured)),
        estop=False,
        homing=SimpleNamespace(refusal=""),
        operating=SimpleNamespace(trouble=""),
        reset_tick=None,
        dialogue=None,
        durations=Durations(0.3, 0.1, 0.1),
        parts=SimpleNamespace(
            rate_Hz=RATE_Hz,
            fusion=None,
            protocol=SET_UP,
            setup=DriveSetup(0.01, Reaction.BRAKE, RATE_Hz),
            safety=SimpleNamespace(
                limits={"stale_fault_ticks": np.int64(5)},
                memory={"refused": 0b11111, "running": 0, "untrusted": 0},
            ),
        ),
    )


def states(*different):
    return np.array([*different, *[DriveState.OFF] * (6 - len(different))], np.int64)


def first_end(course, until):
    """Return the first ending, looked for in every tick."""
    for tick in range(until):
        ending = course.ending(tick)
        if ending is not None:
            return ending
    return None


def test_engages_once_idle_and_never_twice():
    now = cycle(Mode.WAITING)
    course = Course(now)
    assert course.commands(0) == ()
    now.mode = Mode.IDLE
    assert course.commands(1) == (Operator.ENGAGE,)
    assert course.commands(2) == ()


@pytest.mark.parametrize("armed", [True, False])
def test_a_consent_that_came_with_a_drive_that_was_switched_off_is_asked_for_again(armed):
    """The cycle went back to WAITING in the tick of the consent; later it has all drives again."""
    now = cycle(Mode.IDLE)
    course = Course(now, 5.0, armed=armed)
    said = () if armed else (Operator.ENGAGE,)
    assert course.commands(0, said) == (Operator.ENGAGE,)
    now.mode = Mode.WAITING
    assert course.commands(1) == ()
    now.mode = Mode.IDLE
    assert course.commands(2, said) == (Operator.ENGAGE,)
    now.mode = Mode.LOADING
    assert course.commands(3) == ()
    now.mode = Mode.WAITING  # parked, and reset by the operator
    course.commands(5000)
    now.mode = Mode.IDLE
    assert course.commands(5001) == (), "that needs a new word"


@pytest.mark.parametrize("duration_s", [None, 5.0])
def test_a_fault_before_the_platform_moved_takes_the_consent_back(duration_s):
    now = cycle(Mode.FAULT, faults=Fault.ESTOP)
    course = Course(now, duration_s)
    assert course.commands(0, (Operator.RESET,)) == (Operator.RESET,)
    now.mode = Mode.WAITING
    assert course.commands(1) == ()
    now.mode = Mode.IDLE
    assert course.commands(2) == ()
    assert course.waits_for_consent
    assert course.commands(3, (Operator.ENGAGE,)) == (Operator.ENGAGE,)


def test_a_reset_of_the_drives_while_they_are_waited_for_takes_no_consent_back():
    now = cycle(Mode.WAITING)
    course = Course(now)
    course.commands(0, (Operator.RESET,))
    now.mode = Mode.IDLE
    assert course.commands(1) == (Operator.ENGAGE,)


@pytest.mark.parametrize("mode", [Mode.FAULT, Mode.PARKED])
def test_a_run_that_stays_does_so_before_it_was_ever_armed(mode):
    now = cycle(mode, faults=Fault.ESTOP if mode is Mode.FAULT else Fault.NONE)
    course = Course(now, armed=False, goes_on=True)
    assert first_end(course, 1000) is None
    course.commands(1000, (Operator.END,))
    assert first_end(course, 1000) is not None


def test_a_leg_that_moves_after_a_fault_is_waited_for_ten_seconds_or_until_the_operator_leaves():
    now = cycle(Mode.FAULT, faults=Fault.ESTOP, rate=np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]))
    ending = first_end(Course(now), 2000)
    assert ending is not None
    assert ending.ticks == 1000
    assert ending.reason.endswith("; still moving: leg 2 at +0.020 m/s")
    course = Course(now, stays=True)
    assert first_end(course, 3000) is None
    course.commands(3000, (Operator.STOP,))
    assert course.ending(3000) is None
    course.commands(3001, (Operator.ESTOP,))
    ending = course.ending(3001)
    assert ending is not None
    assert "still moving: leg 2" in ending.reason


@pytest.mark.parametrize(("stays", "tick"), [(False, 100), (True, None)])
def test_a_platform_that_is_held_with_force_is_held_for_a_second_or_until_the_operator_releases_it(
    stays, tick
):
    ending = first_end(Course(cycle(Mode.HELD, faults=Fault.ESTOP), stays=stays), 2000)
    assert (ending.ticks if ending else None) == tick


@pytest.mark.parametrize(("stays", "tick"), [(False, 1000), (True, None)])
def test_a_platform_that_goes_to_closed_brakes_and_is_held_again_is_held_for_ten_seconds_in_all(stays, tick):
    """Where frames are lost no brake test comes to its end; 0.2 s of each in turn."""
    now = cycle(Mode.HELD, faults=Fault.STALE)
    course, found = Course(now, stays=stays), None
    for number in range(3000):
        if number % 20 == 0:
            now.mode, now.mode_tick = (Mode.HELD, Mode.UNLOADING)[number // 20 % 2], number
        found = found or course.ending(number)
    assert (found.ticks if found else None) == tick


def test_a_run_that_stays_and_finds_no_drives_ends():
    now = cycle(Mode.WAITING, age=NEVER)
    assert first_end(Course(now, armed=False, goes_on=True), 1000) is not None


def test_stops_once_at_its_duration_also_where_that_tick_is_skipped():
    course = Course(cycle(Mode.TRACKING), 0.5)
    assert course.commands(49) == ()
    assert course.commands(53) == (Operator.STOP,)
    assert course.commands(54) == ()


def test_resets_in_the_first_tick_alone_and_only_on_request():
    assert Course(cycle(Mode.WAITING)).commands(0) == ()
    course = Course(cycle(Mode.WAITING), reset=True)
    assert course.commands(0) == (Operator.RESET,)
    assert course.commands(1) == ()


def test_its_own_commands_come_before_the_operators():
    course = Course(cycle(Mode.IDLE), 0.01, reset=True)
    mine = (Operator.RESET, Operator.ENGAGE, Operator.STOP)
    assert course.commands(1, (Operator.ESTOP,)) == (*mine, Operator.ESTOP)


STALE_LIMIT = "limits.stale_fault_ticks is 5"
ENDS = {Mode.PARKED, Mode.FAULT, Mode.WAITING, Mode.HELD}


@pytest.mark.parametrize("mode", [m for m in Mode if m not in ENDS])
def test_goes_on_between_the_start_and_the_end(mode):
    assert first_end(Course(cycle(mode, drive_state=states(DriveState.FAULT))), 3000) is None


def test_ends_parked_as_soon_as_all_drives_are_off():
    now = cycle(Mode.PARKED, mode_tick=7, drive_state=states(*[DriveState.OFF] * 5, DriveState.READY))
    course = Course(now)
    assert course.ending(8) is None
    now.tick = altered(now.tick, drive_state=states())
    assert course.ending(9) == Ending(Mode.PARKED, Fault.NONE, "", 9)


def test_ends_parked_a_quarter_of_a_second_later_where_a_drive_does_not_report_off():
    ending = first_end(Course(cycle(Mode.PARKED, mode_tick=7, drive_state=states(DriveState.BOOT))), 1000)
    assert ending == Ending(Mode.PARKED, Fault.NONE, "", 7 + 25)


@pytest.mark.parametrize(
    ("duration_s", "operator", "requested"),
    [(None, (), False), (0.1, (), True), (None, (Operator.STOP,), True), (None, (Operator.ESTOP,), True)],
)
def test_a_stop_by_the_operator_or_the_duration_was_requested(duration_s, operator, requested):
    course = Course(cycle(Mode.PARKED), duration_s)
    course.commands(10, operator)
    ending = course.ending(10)
    assert ending is not None
    assert ending.requested is requested
    assert ending.success


@pytest.mark.parametrize(
    ("stop", "what"),
    [
        (Stop.MISSED, "limits.missed_stop_ticks"),
        (Stop.RECORDER, "recording.on_recorder_loss"),
        (Stop.STRETCHED, "limits.stretch_percent"),
    ],
)
def test_a_stop_by_safety_is_no_success_and_says_why(stop, what):
    ending = first_end(Course(cycle(Mode.PARKED, stop=stop)), 10)
    assert ending is not None
    assert (ending.success, ending.requested) == (False, False)
    assert what in ending.reason


def test_ends_a_quarter_of_a_second_after_a_fault_with_what_was_known_in_its_tick():
    now = cycle(Mode.FAULT, mode_tick=40, faults=Fault.STALE, counted_age=np.array([0, 0, 5, 0, 0, 0]))
    course = Course(now)
    assert course.ending(40) is None
    now.tick = altered(now.tick, counted_age=[9, 9, 30, 9, 9, 9])
    assert course.ending(64) is None
    text = "latched fault STALE (leg 2 not heard for 5 ticks, limits.stale_fault_ticks is 5)"
    assert course.ending(65) == Ending(Mode.FAULT, Fault.STALE, text, 65, 40)


@pytest.mark.parametrize(
    ("ages", "said"),
    [
        ([3, 3, 5, 1, 3, 1], f"(leg 2 not heard for 5 ticks, {STALE_LIMIT})"),
        ([0, 7, 5, 0, 0, 0], f"(leg 1, 2 not heard for 7, 5 ticks, {STALE_LIMIT})"),
        (
            [5, 6, 5, 5, 5, 5],
            f"(no leg heard for 5 ticks, {STALE_LIMIT}: the drives, the bus or this machine had stalled for 50 ms by then;",
        ),
    ],
)
def test_a_stale_fault_names_the_legs_that_reached_its_limit(ages, said):
    now = cycle(Mode.FAULT, mode_tick=1, faults=Fault.STALE, counted_age=np.array(ages))
    ending = first_end(Course(now), 100)
    assert ending is not None
    assert said in ending.reason


@pytest.mark.parametrize("asked", [(), (Operator.STOP,), (Operator.STOP, Operator.END)])
def test_a_run_that_was_over_before_its_drives_were_ready_is_no_success_but_on_request(asked):
    now = cycle(Mode.WAITING, age=NEVER)
    course = Course(now, duration_s=None if asked else 1.0)
    for tick in range(101):
        course.commands(tick, asked if tick == 100 else ())
    now.mode, now.mode_tick = Mode.PARKED, 101
    ending = first_end(course, 200)
    assert ending is not None
    assert ending.success == bool(asked)
    assert ("drive 0 never answered" in ending.reason) == (not asked)


def test_a_second_fault_after_a_reset_has_a_tail_and_a_text_of_its_own():
    now = cycle(Mode.FAULT, mode_tick=40, faults=Fault.ESTOP)
    course = Course(now)
    assert course.ending(50) is None
    now.mode, now.mode_tick, now.faults = Mode.FAULT, 60, Fault.BUS
    assert course.ending(60) is None
    assert course.ending(84) is None
    text = "latched fault BUS (the bus did not take our frames in 5 ticks in a row; 5 are a dead bus)"
    assert course.ending(85) == Ending(Mode.FAULT, Fault.BUS, text, 85, 60)


def test_a_slow_loop_still_tells_the_drives_to_switch_off_five_times():
    slow = cycle(Mode.FAULT, faults=Fault.BUS)
    slow.parts.rate_Hz = 5.0
    ending = first_end(Course(slow), 100)
    assert ending is not None
    assert ending.ticks == 5


def test_ends_after_two_seconds_without_any_drive():
    never = FIRST["age"]
    assert first_end(Course(cycle(Mode.WAITING, age=never)), 3000) == Ending(
        Mode.WAITING, Fault.NONE, "no drives", 200
    )


def test_one_drive_heard_is_waited_for_ten_seconds_and_the_others_are_named():
    age = FIRST["age"].copy()
    age[4] = 0
    ending = first_end(Course(cycle(Mode.WAITING, age=age)), 3000)
    assert ending is not None
    assert ending.ticks == 1000
    assert "drive 0 never answered" in ending.reason
    assert "drive 4" not in ending.reason


@pytest.mark.parametrize("leg", range(6))
def test_a_fault_that_a_drive_has_latched_before_ends_the_wait_after_two_seconds(leg):
    state = states()
    state[leg] = DriveState.FAULT
    ending = first_end(Course(cycle(Mode.WAITING, drive_state=state)), 3000)
    assert ending is not None
    assert ending.ticks == 200
    assert f"drive {leg} stays in FAULT" in ending.reason
    assert "--reset" in ending.reason


class Wire:
    """The ideal bus of a lockstep behind the calls that the daemon makes."""

    def __init__(self, nodes, period_ns):
        self.nodes, self.period_ns, self.tick = nodes, period_ns, -1
        self.period_s = 0.0
        self.commands, self.answers, self.late = [], [], []
        self.clock = SimpleNamespace(stretched=lambda: 0, working=lambda _: None, now=self.now)
        nodes.start(0)

    def now(self):
        return self.tick * self.period_ns

    # what the daemon asks of its deadlines
    def wait(self):
        self.tick += 1
        return self.tick, self.tick * self.period_ns, 0, 0

    # ... and of the bus
    def skew_ns(self):
        return 0

    def sent_ns(self):
        return []

    def flush_tx(self):
        pass

    def send(self, frames):
        t_ns = self.tick * self.period_ns
        self.commands += [Received(t_ns, frame) for frame in frames]
        if not self.answers:
            self.answers = [Received(*reply) for reply in self.nodes.step(t_ns, self.commands)] or [None]
            self.commands = []
        return 0

    def drain_now(self):
        late, self.late, self.answers = self.late, [], []
        return late

    def drain(self, deadline_ns, wanted):
        """Return the feedbacks; a status loses the arbitration against the last of them, and is late."""
        answers = [answer for answer in self.answers if answer is not None]
        self.answers = [None]
        self.late += [answer for answer in answers if answer.frame.id not in wanted]
        return [answer for answer in answers if answer.frame.id in wanted]

    def events(self):
        return SimpleNamespace(errors=0, off=0, overflow=0, state=BusState.UNKNOWN)


ALL_LOST = FramesLoss()
LEG_0 = DriveSilence(leg=0)


@pytest.mark.parametrize(
    ("faults", "mode", "seconds"),
    [
        ([], Mode.PARKED, None),
        ([ALL_LOST], Mode.WAITING, 2.0),
        ([FramesLoss(at_s=1.0)], Mode.FAULT, None),
        ([LEG_0], Mode.WAITING, 10.0),
        ([DriveSilence(leg=4, at_s=0.3)], Mode.HELD, None),
        ([DriveSilence(leg=2, at_s=1.2)], Mode.HELD, None),
        ([EncoderJump(leg=5, by_m=0.3, at_s=1.1)], Mode.HELD, None),
    ],
)
def test_the_same_faults_end_the_daemon_and_the_lockstep_alike(faults, mode, seconds):
    c = load("ideal")
    rate, duration_s = c.loop.rate_Hz, None if mode is Mode.WAITING else 1.4

    def ends():
        nodes, plant = build_nodes(c, FaultPlan(faults))
        return build_cycle(c, rate, c.drives.watchdog_ms * 1e-3), nodes, plant

    here, nodes, plant = ends()
    rows = []
    stepped = Lockstep(here, nodes, None, 0.0).run(duration_s, lambda *args: rows.append(args[2].row))
    plant.close()

    there, nodes, plant = ends()
    wire, seen = Wire(nodes, round(1e9 / rate)), []
    recording = SimpleNamespace(alive=True, dropped=0, tick=lambda row, *_, **__: seen.append(row))
    shell = Shell(wire, wire, recording, OperatorPanel(), 0)  # type: ignore[arg-type]
    ran = run(Course(there, duration_s), shell)
    plant.close()

    assert (ran, ran.story) == (stepped, stepped.story)
    assert ran.mode is mode, ran
    assert len(seen) == len(rows) == ran.ticks + 1
    assert all((a["mode"], a["faults"]) == (b["mode"], b["faults"]) for a, b in zip(rows, seen, strict=True))
    if seconds is not None:
        assert ran.ticks == round(seconds * rate)


class Stamped(Wire):
    """Each SYNC is out 123 us after the wake-up."""

    def sent_ns(self):
        return [self.tick * self.period_ns + 123_000]


class Stalled(Stamped):
    """Giving a SYNC to the bus takes 0.3 ms; the answers are there after 45 us."""

    def __init__(self, nodes, period_ns):
        super().__init__(nodes, period_ns)
        self.given = False

    def now(self):
        return self.tick * self.period_ns + 300_000 * self.given

    def send(self, frames):
        self.given = True
        return super().send(frames)

    def drain_now(self):
        self.given = False
        return super().drain_now()

    def drain(self, deadline_ns, wanted):
        came_ns = self.tick * self.period_ns + 45_000
        return [answer._replace(t_ns=came_ns) for answer in super().drain(deadline_ns, wanted)]


@pytest.mark.parametrize(("answer_ns", "delay_ns"), [(None, 123_000), (0, 45_000)])
def test_answers_are_asked_where_the_bus_does_not_know_when_its_frames_were_out(answer_ns, delay_ns):
    assert latched(Stalled, answer_ns) == [[delay_ns] * 6] * 3


def test_the_daemon_records_when_each_drive_latched():
    assert latched(Stamped, None) == [[123_000] * 6] * 3


def latched(kind, answer_ns):
    """Return the latches that three ticks on such a wire are recorded with, ns."""
    c = load("ideal")
    nodes, plant = build_nodes(c)
    wire, rows = kind(nodes, round(1e9 / c.loop.rate_Hz)), []

    def tick(row, *_, **__):
        rows.append(row)
        if len(rows) == 3:
            raise RuntimeError("enough")

    recording = SimpleNamespace(alive=True, dropped=0, tick=tick)
    shell = Shell(wire, wire, recording, OperatorPanel(), 0, answer_ns=answer_ns)  # type: ignore[arg-type]
    run(Course(build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)), shell)
    plant.close()
    return [row["latch_ns"].tolist() for row in rows]


def test_what_the_plant_says_of_itself_comes_before_what_the_controller_saw_of_it():
    now = cycle(Mode.FAULT, mode_tick=1, faults=Fault.STALE, counted_age=np.array([5] * 6))
    ending = first_end(Course(now), 100)
    assert ending is not None
    assert ending.blamed("") is ending
    blamed = ending.blamed("my.fmu: the FMU did not step within 5 s")
    assert blamed.trouble.startswith(
        "my.fmu: the FMU did not step within 5 s; the controller: latched fault STALE"
    )
    assert blamed.story is not None
    assert blamed.story.lines()[0] == "plant: my.fmu: the FMU did not step within 5 s"
    assert next(iter(blamed.story.next)).startswith("mend the plant")
    parked = Ending(Mode.PARKED, Fault.NONE, "", 100, -1)
    assert parked.success
    assert not parked.blamed("the plant was killed").success
