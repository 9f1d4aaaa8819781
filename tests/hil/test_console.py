"""The operator of a run: which words count in which mode, what he is answered, and what his status says."""

from __future__ import annotations

import json
import tempfile
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.signals import Mode, Refusal
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load, loads
from hil.config.reference import LiveReference
from hil.loop.admission import Counts
from hil.loop.console import Console, status_text
from hil.loop.panel import OperatorPanel
from hil.loop.run_end import Course
from hil.operate.channel import AT_MOST, OperatorChannel
from hil.operate.client import OperatorClient
from hil.signals import Operator
from tests.live_reference import LIVE_REFERENCE


@pytest.fixture
def ends(monkeypatch):
    """The loop's end of the channel, and the operator's."""
    with tempfile.TemporaryDirectory(prefix="op") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        with OperatorChannel("localcan", "a") as channel, OperatorClient("localcan", "a") as client:
            yield channel, client


@pytest.fixture(scope="module")
def cycle():
    return build_cycle(load("virtual"), 1000.0, 0.01)


def said(cycle, ends, mode, line, **course):
    """What comes through of a line in a mode, the answer, and the events in the log."""
    channel, client = ends
    cycle.mode = mode
    console = Console(Course(cycle, armed=False, **course), OperatorPanel(), channel)
    events: list[str] = []
    recording: Any = SimpleNamespace(event=lambda *event: events.append(event[-1]))
    console.take()
    console.answer(recording, 0)
    client._socket.send(line.encode())
    heard = console.take()
    cycle.operating.answers = [""] * len(heard.orders)
    console.answer(recording, 0)
    return heard, client._socket.recv(4096).decode(), events


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
def test_each_word_counts_where_it_means_something_and_is_refused_elsewhere(cycle, ends, word, mode):
    where, commands = COUNTS_IN[word]
    heard, answer, events = said(cycle, ends, mode, word)
    if mode in where:
        assert (heard.operator, answer, events) == (commands, "taken", [])
    else:
        assert heard.operator == ()
        assert answer.startswith("refused: ")
        assert events == [f"operator's command refused: {answer.removeprefix('refused: ')}"]


def test_no_release_that_waited_before_the_platform_was_held_lets_go_of_it(cycle, ends):
    channel, client = ends
    console = Console(Course(cycle, armed=False), OperatorPanel(), channel)
    cycle.mode = Mode.TRACKING
    console.take()
    for _ in range(AT_MOST + 2):
        client._socket.send(b"release")
    cycle.mode = Mode.HELD
    heard = [console.take().operator for _ in range(3)]
    assert heard == [(), (), ()]
    client._socket.send(b"release")
    assert console.take().operator == (Operator.RELEASE,)


def test_no_release_that_waited_before_the_first_tick_lets_go_of_a_platform(cycle, ends):
    channel, client = ends
    client._socket.send(b"release")
    cycle.mode = Mode.HELD
    console = Console(Course(cycle, armed=False), OperatorPanel(), channel)
    assert console.take().operator == ()


def test_a_word_that_was_refused_is_told_of_once_whatever_is_asked_next(cycle, ends):
    channel, client = ends
    cycle.mode = Mode.TRACKING
    console = Console(Course(cycle, armed=False), OperatorPanel(), channel)
    events: list[str] = []
    recording: Any = SimpleNamespace(event=lambda *event: events.append(event[-1]))
    for line, answer in (
        (b"arm", "refused: "),
        (b"status", "{"),
        (b"setpoint 0 0 1", "refused: the reference"),
    ):
        console.take()
        client._socket.send(line)
        cycle.operating.answers = []
        console.take()
        console.answer(recording, 0)
        assert client._socket.recv(4096).decode().startswith(answer)
    assert [event.split(" to ")[0] for event in events] == ["operator's command refused: there is nothing"]


@pytest.mark.parametrize("channel", [None, SimpleNamespace(waited_for=False)], ids=["none", "silent"])
def test_where_nobody_has_a_channel_or_waits_at_it_nobody_is_answered(cycle, channel):
    events: list[Any] = []
    recording: Any = SimpleNamespace(event=lambda *event: events.append(event))
    cycle.operating.answers = ["refused"]
    Console(Course(cycle), OperatorPanel(), channel).answer(recording, 7)
    assert events == []


def test_the_log_is_told_when_which_words_and_orders_were_refused(cycle, ends):
    channel, client = ends
    cycle.mode = Mode.TRACKING
    console = Console(Course(cycle, armed=False), OperatorPanel(), channel)
    events: list[Any] = []
    recording: Any = SimpleNamespace(event=lambda *event: events.append(event))
    console.take()
    for line in (b"hold", b"arm", b"start"):
        client._socket.send(line)
    console.take()
    cycle.operating.answers = ["", "the key is not held"]
    console.answer(recording, 7)
    assert [client._socket.recv(4096).decode().split(":")[0] for _ in range(3)].count("refused") == 2
    ((t_ns, level, text),) = events
    assert (t_ns, level) == (7, "warning")
    assert text.startswith("operator's command refused: there is nothing to arm in mode TRACKING")
    assert text.endswith("; the key is not held")


def test_a_parked_run_is_reset_only_where_it_stays(cycle, ends):
    assert said(cycle, ends, Mode.PARKED, "reset", goes_on=True)[0].operator == (Operator.RESET,)


def test_a_set_point_for_a_path_is_refused_and_goes_nowhere(cycle, ends):
    heard, answer, _ = said(cycle, ends, Mode.TRACKING, "setpoint 0 0 1")
    assert heard.setpoints == ()
    assert answer == "refused: the reference takes no set-points: reference.type has to be live"


def test_each_set_point_for_a_path_is_refused_in_its_own_tick_however_many_came_before(cycle, ends):
    channel, client = ends
    cycle.mode = Mode.TRACKING
    console = Console(Course(cycle, armed=False), OperatorPanel(), channel)
    recording: Any = SimpleNamespace(event=lambda *_: None)
    console.take()
    for count in (1, 2, 1):
        for _ in range(count):
            client._socket.send(b"setpoint 0 0 1")
        console.take()
        cycle.operating.answers = []
        console.answer(recording, 0)
        answers = [client._socket.recv(4096).decode() for _ in range(count)]
        assert (
            answers == ["refused: the reference takes no set-points: reference.type has to be live"] * count
        )


@pytest.mark.parametrize(
    ("goes_on", "commands"), [(True, (Operator.STOP, Operator.END)), (False, (Operator.STOP,))]
)
def test_ctrl_c_ends_a_run_that_stays(cycle, goes_on, commands):
    panel = OperatorPanel()
    panel.running()
    panel.interrupt(2, None)
    cycle.mode = Mode.TRACKING
    assert Console(Course(cycle, goes_on=goes_on), panel).take().operator == commands


@pytest.mark.parametrize("line", ["", "status", "hold", "setpoint 0 0 1", "arm", "no word"])
def test_ctrl_c_stops_a_run_that_has_a_channel_whatever_is_said_there(cycle, ends, line):
    channel, client = ends
    panel = OperatorPanel()
    panel.running()
    cycle.mode = Mode.TRACKING
    console = Console(Course(cycle), panel, channel)
    console.take()
    if line:
        client._socket.send(line.encode())
    panel.interrupt(2, None)
    assert console.take().operator == (Operator.STOP,)


@pytest.mark.parametrize("channel", [None, SimpleNamespace(waited_for=False)], ids=["none", "silent"])
def test_the_log_is_told_of_a_refused_set_point_also_where_nobody_waits_for_an_answer(channel):
    reference = LiveReference.model_validate(LIVE_REFERENCE)
    live = build_cycle(load("virtual").model_copy(update={"reference": reference}), 1000.0, 0.01)
    assert live.parts.steering is not None
    live.parts.steering.counts = Counts(0, 1, int(Refusal.STROKE))
    told: list[Any] = []
    recording: Any = SimpleNamespace(event=lambda *event: told.append(event))
    Console(Course(live), OperatorPanel(), channel).answer(recording, 7)
    ((t_ns, level, text),) = told
    assert (t_ns, level) == (7, "warning")
    assert text.startswith("set-point refused: ")


@pytest.mark.parametrize("armed", [False, True])
@pytest.mark.parametrize("mode", Mode)
def test_enter_is_looked_at_and_arms_only_where_consent_is_waited_for(cycle, mode, armed):
    asked = []

    def consent():
        asked.append(mode)
        return True

    cycle.mode = mode
    console = Console(Course(cycle, armed=armed), OperatorPanel(), consent=consent)
    waits = mode is Mode.IDLE and not armed
    assert console.take().operator == (Operator.ENGAGE,) * waits
    assert len(asked) == waits


def test_enter_counts_once_and_not_again_after_a_fault_in_motion(cycle):
    cycle.mode = Mode.IDLE
    course = Course(cycle, armed=False)
    console = Console(course, OperatorPanel(), consent=lambda: True)
    assert course.commands(0, console.take().operator) == (Operator.ENGAGE,)
    for tick, mode in enumerate((Mode.IDLE, Mode.LOADING, Mode.FAULT, Mode.WAITING, Mode.IDLE), 1):
        cycle.mode = mode
        assert course.commands(tick, console.take().operator) == ()


def test_a_status_is_composed_once_in_ten_milliseconds_however_often_it_is_asked_for(
    cycle, ends, monkeypatch
):
    channel, client = ends
    composed = []

    def compose(course, malformed):
        composed.append((int(course.cycle.tick["tick"]), malformed))
        return "{}"

    monkeypatch.setattr("hil.loop.console.status_text", compose)
    cycle.mode = Mode.TRACKING
    console = Console(Course(cycle), OperatorPanel(), channel)
    channel.malformed = 3
    for tick in range(100):
        cycle.tick["tick"] = tick
        client._socket.send(b"status")
        console.take()
        console.answer(None, 0)  # type: ignore[arg-type]
        assert client._socket.recv(100) == b"{}"
    assert composed == [(tick, 3) for tick in range(0, 100, 10)]


def test_the_status_names_mode_pose_key_and_what_is_waited_for():
    text = load("virtual").text.replace("\nreference: ", "\noperator: {deadman_s: 0.1}\n\nreference: ")
    cycle = build_cycle(loads(text), 1000.0, 0.01)
    course = Course(cycle)
    cycle.mode, cycle.operating.go = Mode.TRACKING, False
    cycle.tick["p"], cycle.tick["R"] = [0.1, 0.2, 1.0], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    cycle.tick["tick"] = 500
    status = json.loads(status_text(course, 3))
    assert status["mode"] == "TRACKING"
    assert status["position_m"] == [0.1, 0.2, 1.0]
    np.testing.assert_allclose(status["rotation_vector_deg"], [0, 0, 90], atol=1e-9)
    assert (status["held"], status["key"], status["refused_lines"]) == (True, "missing", 3)
    assert status["waits_for"].startswith("the key is not held")
    cycle.operating.key_tick = 450
    status = json.loads(status_text(course, 3))
    assert (status["key"], status["waits_for"]) == ("held", "start")
    assert status["path_length_s"] == 20.0
    cycle.mode = Mode.IDLE
    status = json.loads(status_text(course, 0))
    assert status["waits_for"].startswith("arm")
    assert status["leg_lengths_m"] is None, "no leg was ever heard"


def test_a_status_has_no_number_that_json_lacks():
    cycle = build_cycle(load("virtual"), 1000.0, 0.01)
    cycle.tick["age"] = 0
    cycle.tick["p"][0] = cycle.tick["R"][0, 0] = cycle.tick["q"][3] = np.nan

    def complain(constant):
        raise AssertionError(constant)

    status = json.loads(status_text(Course(cycle), 0), parse_constant=complain)
    assert status["position_m"] is status["rotation_vector_deg"] is status["leg_lengths_m"] is None
    cycle.tick["q"] = 1.25
    assert json.loads(status_text(Course(cycle), 0))["leg_lengths_m"] == [1.25] * 6


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.TRACKING])
def test_a_set_point_for_a_live_reference_comes_through_and_is_answered_by_what_became_of_it(ends, mode):
    reference = LiveReference.model_validate(LIVE_REFERENCE)
    c = load("virtual").model_copy(update={"reference": reference})
    live, (channel, client) = build_cycle(c, 1000.0, 0.01), ends
    console, told = Console(Course(live), OperatorPanel(), channel), list[tuple[int, str, str]]()
    recording: Any = SimpleNamespace(event=lambda *event: told.append(event))
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
    said = client._socket.recv(4096).decode()
    assert (said == "taken") == (mode is Mode.TRACKING)
    assert told == ([] if said == "taken" else [(7, "warning", f"set-point {said}")])
