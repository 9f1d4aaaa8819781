"""The operator of a run: valid words of each mode, answers, and status."""

from __future__ import annotations

import json
import tempfile
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.signals import NEVER, Fault, Mode, Refusal
from hil.app.compose import build_cycle
from hil.contracts.records import record_of
from hil.loop.admission import Counts
from hil.loop.console import Console, status_text, waits_for
from hil.loop.operating import NO_KEY
from hil.loop.panel import OperatorPanel
from hil.loop.run_end import Course
from hil.operate.channel import AT_MOST, OperatorChannel
from hil.operate.client import OperatorClient
from hil.signals import Operator
from tests.hil.cycle_bench import LIVE, VIRTUAL


@pytest.fixture
def ends(monkeypatch):
    """The loop's end of the channel, and the operator's."""
    with tempfile.TemporaryDirectory(prefix="op") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        with OperatorChannel("localcan", "a") as channel, OperatorClient("localcan", "a") as client:
            yield channel, client


@pytest.fixture(scope="module")
def cycle():
    return build_cycle(VIRTUAL, 1000.0, 0.01)


class Log:
    """Stores the events of a recording."""

    def __init__(self) -> None:
        self.events: list[tuple[int, str, str]] = []

    def event(self, *event: Any) -> None:
        self.events.append(event)


class Desk:
    """A console in a mode, after its first tick, and the client at its channel."""

    def __init__(self, cycle, ends, mode, **course):
        self.cycle, (self.channel, self.client) = cycle, ends
        cycle.mode = mode
        self.console = Console(Course(cycle, armed=False, **course), OperatorPanel(), self.channel)
        log: Any = Log()
        self.log = log
        self.console.take()
        self.console.answer(self.log, 0)

    def say(self, *lines):
        """Send lines and run one tick; return the accepted commands and the answers."""
        for line in lines:
            self.client._socket.send(line.encode())
        heard = self.console.take()
        self.cycle.operating.answers = [""] * len(heard.orders)
        self.console.answer(self.log, 7)
        return heard, [self.client._socket.recv(4096).decode() for _ in lines]


COUNTS_IN = {
    "arm": ({Mode.IDLE}, (Operator.ENGAGE,)),
    "reset": ({Mode.FAULT, Mode.WAITING}, (Operator.RESET,)),
    "release": ({Mode.HELD}, (Operator.RELEASE,)),
    "stop": (set(Mode), (Operator.STOP,)),
    "estop": (set(Mode), (Operator.ESTOP,)),
    "end": (set(Mode), (Operator.END, Operator.STOP)),
}


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("word", COUNTS_IN)
def test_operator_command_is_accepted_only_in_its_modes_and_refused_in_others(cycle, ends, word, mode):
    where, commands = COUNTS_IN[word]
    desk = Desk(cycle, ends, mode)
    heard, (answer,) = desk.say(word)
    if mode in where:
        assert (heard.operator, answer, desk.log.events) == (commands, "taken", [])
    else:
        assert heard.operator == ()
        assert answer.startswith("refused: ")
        why = answer.removeprefix("refused: ")
        assert desk.log.events == [(7, "warning", f"operator's command refused: {why}")]


def test_a_parked_run_can_be_reset_only_if_it_stays(cycle, ends):
    assert Desk(cycle, ends, Mode.PARKED, goes_on=True).say("reset")[0].operator == (Operator.RESET,)


def test_a_release_sent_before_the_platform_was_held_is_ignored(cycle, ends):
    desk = Desk(cycle, ends, Mode.TRACKING)
    for _ in range(AT_MOST + 2):
        desk.client._socket.send(b"release")
    cycle.mode = Mode.HELD
    assert [desk.console.take().operator for _ in range(3)] == [(), (), ()]
    desk.client._socket.send(b"release")
    assert desk.console.take().operator == (Operator.RELEASE,)


def test_a_release_sent_before_the_first_tick_is_ignored(cycle, ends):
    channel, client = ends
    client._socket.send(b"release")
    cycle.mode = Mode.HELD
    assert Console(Course(cycle, armed=False), OperatorPanel(), channel).take().operator == ()


def test_refused_operator_command_is_logged_once_whatever_follows(cycle, ends):
    desk = Desk(cycle, ends, Mode.TRACKING)
    for line, answer in (
        ("arm", "refused: "),
        ("status", "{"),
        ("setpoint 0 0 1", "refused: only a live reference"),
    ):
        assert desk.say(line)[1][0].startswith(answer)
    assert len(desk.log.events) == 1
    _, answers = desk.say("hold", "arm", "start")
    assert [answer.split(":")[0] for answer in answers].count("refused") == 1


def test_set_points_for_a_fixed_path_are_refused_in_their_own_tick(cycle, ends):
    desk = Desk(cycle, ends, Mode.TRACKING)
    for count in (1, 2, 1):
        heard, answers = desk.say(*["setpoint 0 0 1"] * count)
        assert heard.setpoints == ()
        assert len(answers) == count
        assert all("reference.type" in answer for answer in answers)


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.TRACKING])
def test_set_point_for_a_live_reference_is_passed_to_the_controller_and_answered(ends, mode):
    live, (channel, client) = build_cycle(VIRTUAL.model_copy(update={"reference": LIVE}), 1000.0, 0.01), ends
    console, log = Console(Course(live), OperatorPanel(), channel), Log()
    recording: Any = log
    live.mode = mode
    for _ in range(2):
        console.take()
        console.answer(recording, 0)
    client._socket.send(b"setpoint 0 0 1.01")
    heard = console.take()
    assert [tuple(each) for each in heard.setpoints] == [(0.0, 0.0, 1.01, 0.0, 0.0, 0.0)]
    steering: Any = live.parts.steering
    steering.take(heard.setpoints, tracking=mode is Mode.TRACKING)
    console.answer(recording, 7)
    answer = client._socket.recv(4096).decode()
    assert (answer == "taken") == (mode is Mode.TRACKING)
    assert log.events == ([] if answer == "taken" else [(7, "warning", f"set-point {answer}")])


@pytest.mark.parametrize("channel", [None, SimpleNamespace(waited_for=False)], ids=["none", "silent"])
def test_refused_set_point_without_a_connected_client_is_logged(channel):
    live = build_cycle(VIRTUAL.model_copy(update={"reference": LIVE}), 1000.0, 0.01)
    assert live.parts.steering is not None
    log: Any = Log()
    live.operating.answers = ["refused"]
    console = Console(Course(live), OperatorPanel(), channel)
    console.answer(log, 7)
    assert log.events == []
    live.parts.steering.counts = Counts(0, 1, int(Refusal.STROKE))
    console.answer(log, 7)
    ((t_ns, level, text),) = log.events
    assert (t_ns, level) == (7, "warning")
    assert text.startswith("set-point refused: ")


# -- Ctrl-C and Enter


@pytest.mark.parametrize(
    ("goes_on", "commands"), [(True, (Operator.STOP, Operator.END)), (False, (Operator.STOP,))]
)
def test_ctrl_c_ends_a_run_that_stays(cycle, goes_on, commands):
    panel = OperatorPanel()
    panel.running()
    panel.interrupt(2, None)
    cycle.mode = Mode.TRACKING
    assert Console(Course(cycle, goes_on=goes_on), panel).take().operator == commands


@pytest.mark.parametrize("armed", [False, True])
@pytest.mark.parametrize("mode", Mode)
def test_enter_is_read_and_arms_only_while_the_run_waits_for_consent(cycle, mode, armed):
    asked: list[Mode] = []

    def consent() -> bool:
        asked.append(mode)
        return True

    cycle.mode = mode
    console = Console(Course(cycle, armed=armed), OperatorPanel(), consent=consent)
    waits = mode is Mode.IDLE and not armed
    assert console.take().operator == (Operator.ENGAGE,) * waits
    assert len(asked) == waits


def test_enter_arms_once_and_not_again_after_a_fault_in_motion(cycle):
    cycle.mode = Mode.IDLE
    course = Course(cycle, armed=False)
    console = Console(course, OperatorPanel(), consent=lambda: True)
    assert course.commands(0, console.take().operator) == (Operator.ENGAGE,)
    for tick, mode in enumerate((Mode.IDLE, Mode.LOADING, Mode.FAULT, Mode.WAITING, Mode.IDLE), 1):
        cycle.mode = mode
        assert course.commands(tick, console.take().operator) == ()


# -- the status


QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def a_course(
    mode=Mode.TRACKING, *, left=None, goes_on=False, faults=Fault.NONE, key=True, word=(), **measured
) -> Any:
    """A run in progress: 250 ticks, 0.25 s of a path of 8 s, at 30 % of the speed and slowing down."""
    pose = {"tick": 250, "age": 0, "p": [0.1, -0.2, 0.5], "R": QUARTER_TURN, "q": np.arange(1.0, 7.0)}
    operating = SimpleNamespace(
        holds_key=lambda tick: key and tick == 250,
        moves=lambda mode: mode in {Mode.APPROACH, Mode.TRACKING},
        **{"speed": 0.6, "patience": 100, "go": True, "trouble": ""} | dict(word),
    )
    motion = SimpleNamespace(
        left=left, away=left is not None, override=SimpleNamespace(sigma=0.3), time=lambda tick: tick * 1e-3
    )
    parts = SimpleNamespace(trajectory=SimpleNamespace(duration_s=8.0))
    cycle = SimpleNamespace(mode=mode, faults=faults, operating=operating, motion=motion, parts=parts)
    cycle.tick = record_of(**(pose | measured))
    return SimpleNamespace(cycle=cycle, goes_on=goes_on)


def complain(constant):
    raise AssertionError(f"JSON has no {constant}")


def status(*args, **kwargs):
    return json.loads(status_text(a_course(*args, **kwargs), 3), parse_constant=complain)


ON_HOLD = {"go": False}
REFUSED = {"go": False, "trouble": "leg 3 is too long"}
UNKNOWN_TURN = QUARTER_TURN + np.array([[0.0, 0.0, np.nan], [0.0] * 3, [0.0] * 3])


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, {"tick": 250, "speed_percent": 60.0, "speed_now_percent": 30.0, "position_m": [0.1, -0.2, 0.5]}),
        ({}, {"leg_lengths_m": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "path_s": 0.25, "path_length_s": 8.0}),
        ({}, {"refused_lines": 3, "mode": "TRACKING", "faults": [], "held": False, "key": "held"}),
        ({"left": (None, 1.5)}, {"path_s": 1.5}),
        ({"mode": Mode.APPROACH}, {"path_s": None}),
        ({"age": np.array([0, 0, 0, 0, 0, NEVER])}, {"leg_lengths_m": None}),
        ({"age": NEVER - 1}, {"leg_lengths_m": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]}),
        ({"q": np.array([0.0, 0.0, np.nan, 0.0, 0.0, 0.0])}, {"leg_lengths_m": None}),
        ({"p": np.array([0.0, np.inf, 0.0])}, {"position_m": None}),
        ({"R": UNKNOWN_TURN}, {"rotation_vector_deg": None, "position_m": [0.1, -0.2, 0.5]}),
        ({"faults": Fault.STALE | Fault.BRAKE}, {"faults": ["STALE", "BRAKE"]}),
        ({"word": {"patience": None}}, {"key": "not needed"}),
        ({"word": ON_HOLD, "key": False}, {"held": True, "key": "missing"}),
        ({"mode": Mode.PARKED, "word": ON_HOLD}, {"held": False}),
    ],
)
def test_status_values_are_in_the_unit_of_their_key_and_null_where_unknown(given, expected):
    found = status(**given)
    assert {key: found[key] for key in expected} == expected
    assert status()["rotation_vector_deg"] == pytest.approx([0.0, 0.0, 90.0])


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({}, ""),
        ({"word": {"speed": 0.0}}, "a speed above 0 %"),
        ({"word": ON_HOLD, "key": False}, NO_KEY),
        ({"word": REFUSED, "key": False}, NO_KEY),
        ({"word": ON_HOLD}, "start"),
        ({"word": ON_HOLD, "left": (None, 1.5)}, "start, which first returns"),
        ({"word": REFUSED}, "another order: leg 3 is too long"),
        ({"mode": Mode.IDLE, "word": ON_HOLD}, "arm"),
        ({"mode": Mode.FAULT, "goes_on": True}, "reset, then arm"),
        ({"mode": Mode.PARKED, "goes_on": True}, "reset, then arm"),
        ({"mode": Mode.FAULT}, ""),
        ({"mode": Mode.PARKED}, ""),
        ({"mode": Mode.PARKING, "word": ON_HOLD}, ""),
        ({"mode": Mode.PARKING, "word": {"speed": 0.0}}, ""),
        ({"mode": Mode.APPROACH, "word": ON_HOLD}, "start"),
        ({"word": ON_HOLD | {"speed": 0.0}}, "start"),
        ({"word": {"speed": 0.001}}, ""),
        ({"mode": Mode.TRACKING, "goes_on": True}, ""),
        ({"mode": Mode.HELD}, "release"),
    ],
)
def test_status_reports_the_operator_command_that_the_run_waits_for(given, text):
    found = waits_for(a_course(**given))
    assert found.startswith(text) if text else not found
