"""Both ends of the operator channel: parsing, answers, and protection against bad senders."""

import math
import os
import stat
import tempfile
import threading
import time
from contextlib import suppress

import pytest

from drivers.errors import RunError
from hil.operate.channel import AT_MOST, Heard, OperatorChannel
from hil.operate.client import OperatorClient, socket_path
from hil.operate.commands import ParsedLine, parse
from hil.signals import Operator, Order, SetPoint


@pytest.fixture
def runtime(monkeypatch):
    """Runtime folder with a short name: a socket path has at most about 100 characters."""
    with tempfile.TemporaryDirectory(prefix="op") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield folder


@pytest.fixture
def channel(runtime):
    with OperatorChannel("localcan", "hil/0") as channel:
        yield channel


class Loop:
    """Thread that ticks a channel and accepts everything; `refuse` is a reason to refuse instead."""

    def __init__(self, channel, refuse=""):
        self.channel, self.refuse, self.heard = channel, refuse, []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work)

    def _work(self):
        while not self._over.is_set():
            heard = self.channel.take()
            refusals = [[self.refuse] * len(kind) for kind in heard]
            self.channel.answer(*refusals, lambda: '{"mode": "TRACKING"}')
            if any(heard):
                self.heard.append(heard)
            time.sleep(2e-4)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *error):
        self._over.set()
        self._thread.join()


WORDS = [
    *(("arm", Operator.ENGAGE), (" stop\n", Operator.STOP), ("estop", Operator.ESTOP)),
    *(("reset", Operator.RESET), ("release", Operator.RELEASE), ("end", Operator.END)),
]
ORDERS = [(each.name.lower(), each) for each in (Operator.START, Operator.HOLD, Operator.PARK, Operator.KEY)]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        *((word, ParsedLine(operator=each)) for word, each in WORDS),
        *((word, ParsedLine(order=Order(each))) for word, each in ORDERS),
        ("speed 40", ParsedLine(order=Order(Operator.SPEED, (0.4,)))),
        ("speed 100%", ParsedLine(order=Order(Operator.SPEED, (1.0,)))),
        ("jog x 1", ParsedLine(order=Order(Operator.JOG, (0.0, 1.0)))),
        ("jog rz -0.5", ParsedLine(order=Order(Operator.JOG, (5.0, -0.5)))),
        ("jog leg0 0", ParsedLine(order=Order(Operator.JOG, (6.0, 0.0)))),
        ("jog leg5 1e-1", ParsedLine(order=Order(Operator.JOG, (11.0, 0.1)))),
        ("setpoint 0.1,-0.2,1e0", ParsedLine(setpoint=SetPoint(0.1, -0.2, 1.0, 0, 0, 0))),
        (
            "setpoint 0.1 -0.2 1 10 20 -30",
            ParsedLine(setpoint=SetPoint(0.1, -0.2, 1.0, math.pi / 18, math.pi / 9, -math.pi / 6)),
        ),
        ("status", ParsedLine()),
    ],
)
def test_valid_operator_line_is_parsed_into_its_command(line, said):
    assert parse(line) == said


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("", "allowed: arm, stop"),
        ("ARM", "'ARM'"),
        ("hold now", "no arguments"),
        ("hold".ljust(513), "512 bytes"),
        ("speed", "0 words"),
        ("speed 100.0001", "0 .. 100"),
        ("speed -1", "-1 %"),
        ("speed nan", "not finite"),
        ("speed 1_0", "not one number"),
        ("speed \u0665", "not one number"),
        ("jog", "0 words"),
        ("jog leg6 1", "'leg6'"),
        ("jog x -1.01", "-1 .. 1"),
        ("jog x nan", "not finite"),
        ("setpoint 1 2", "six numbers"),
        ("setpoint 1 2 3 4 5 inf", "not finite"),
    ],
)
def test_invalid_operator_line_is_refused_with_the_allowed_values(line, complaint):
    with pytest.raises(ValueError, match=complaint):
        parse(line)


def test_each_client_method_sends_its_command_and_gets_the_answer(channel):
    with Loop(channel) as loop, OperatorClient("localcan", "hil/0") as client:
        plain = (client.arm, client.stop, client.reset, client.estop, client.release, client.end)
        orders = (client.start, client.hold, client.park)
        assert all(bool(each()) for each in (*plain, *orders))
        assert client.speed(40)
        assert client.setpoint(0.1, 0, 1, 0, 0, 90)
        assert client.status() == {"mode": "TRACKING"}
        client.key()
        assert client.start()
        assert client.jog_axis("ry", -0.25)
        assert client.jog_leg(3, 1)
    heard = loop.heard
    assert [each for one in heard for each in one.operator] == [
        *(Operator.ENGAGE, Operator.STOP, Operator.RESET, Operator.ESTOP, Operator.RELEASE, Operator.END)
    ]
    given = [order for one in heard for order in one.orders]
    assert [each.command for each in given] == [
        *(Operator.START, Operator.HOLD, Operator.PARK, Operator.SPEED, Operator.KEY, Operator.START),
        *(Operator.JOG, Operator.JOG),
    ]
    assert given[3].numbers == (0.4,)
    assert [each.numbers for each in given[-2:]] == [(4.0, -0.25), (9.0, 1.0)]
    assert [each for one in heard for each in one.setpoints] == [SetPoint(0.1, 0, 1, 0, 0, math.pi / 2)]


def test_a_refused_command_is_answered_with_the_reason(channel):
    with Loop(channel, "not now") as loop, OperatorClient("localcan", "hil/0") as client:
        answer = client.hold()
        assert not answer
        assert answer.why == "not now"
        answer = client.say("jump 3")
        assert answer.why.startswith("'jump' is not an operator command; allowed: arm")
    assert channel.malformed == 1
    assert len(loop.heard) == 1


def test_a_stream_sends_at_its_rate_and_counts_the_answers(channel):
    poses = [(0.0, 0.0, 1.0 + 1e-4 * k) for k in range(100)]
    with Loop(channel) as loop, OperatorClient("localcan", "hil/0") as client:
        found = client.stream(iter(poses), 500.0)
    assert (found.sent, found.taken, found.refused) == (100, 100, 0)
    assert 99 / 500 <= found.seconds < 5
    assert [each.z for one in loop.heard for each in one.setpoints] == [z for _, _, z in poses]


def test_refused_and_unanswered_set_points_are_counted_separately(channel, monkeypatch):
    poses = [(0.0, 0.0, 1.0)] * 4
    with Loop(channel, "out of reach"), OperatorClient("localcan", "hil/0") as client:
        found = client.stream(poses, 500.0)
    assert (found.sent, found.taken, found.refused, found.why) == (4, 0, 4, "out of reach")
    monkeypatch.setattr("hil.operate.client.ANSWER_S", 0.1)
    with OperatorClient("localcan", "hil/0") as client:
        found = client.stream(poses, 500.0)
    assert (found.sent, found.taken, found.refused, found.why) == (4, 0, 0, "")


MALFORMED = (
    *(b" ", b"\0", b"\xff\xfe\x00", b"#", b"# ", b"#1", b"#" * 400, b"9" * 4000, "start １".encode()),
    *(b"#" + b"t" * 20 + b" setpoint 0 0 1." + b"0" * 497 + b"12", b"#1 speed " + b" " * 600 + b"50"),
    *(b"speed 1e999", b"speed --1", b"setpoint " + b"1 " * 250, b"hold\nstart", b"start" + b"\0" * 100),
)


def test_malformed_lines_are_counted_refused_and_have_no_effect(channel):
    with OperatorClient("localcan", "hil/0") as client:
        for n, data in enumerate(MALFORMED, 1):
            client._socket.send(data)
            assert channel.take() == Heard()
            assert channel.malformed == n
            assert b"refused: " in client._socket.recv(4096)


def test_one_tick_reads_a_limited_number_of_lines(channel):
    with OperatorClient("localcan", "hil/0") as client:
        for _ in range(AT_MOST + 2):
            client._socket.send(b"hold")
        assert len(channel.take().orders) == AT_MOST
        assert len(channel.take().orders) == 2


def test_a_client_that_never_reads_is_dropped_without_harm_to_others(channel):
    """Its answers would fill a datagram socket of the loop, and no other client would get an answer."""
    with OperatorClient("localcan", "hil/0") as other, OperatorClient("localcan", "hil/0") as silent:
        with suppress(OSError):
            for _ in range(3000):
                silent._socket.send(b"hold")
                assert len(channel.take().orders) == 1
                channel.answer([], [""], [], str)
        with pytest.raises(RunError, match="does not listen any more"):
            silent.key()
        other._socket.send(b"#1 start")
        assert len(channel.take().orders) == 1
        channel.answer([], ["no"], [], str)
        assert other._socket.recv(4096) == b"#1 refused: no"


def test_a_flooding_client_does_not_delay_other_clients(channel):
    with OperatorClient("localcan", "hil/0") as flood, OperatorClient("localcan", "hil/0") as client:
        for _ in range(50):
            flood._socket.send(b"hold")
        client._socket.send(b"estop")
        assert channel.take().operator == (Operator.ESTOP,)


def test_the_socket_is_private_to_its_owner_and_removed_at_the_end(channel):
    assert stat.S_IMODE(channel.path.stat().st_mode) == 0o600
    assert stat.S_IMODE(channel.path.parent.stat().st_mode) == 0o700
    assert channel.path.stat().st_uid == os.getuid()
    channel.close()
    assert not channel.path.exists()


@pytest.mark.usefixtures("runtime")
def test_a_client_without_a_controller_raises_an_error():
    with pytest.raises(RunError, match="no controller runs on bus localcan:hil/0"):
        OperatorClient("localcan", "hil/0")
    socket_path("localcan", "hil/0").touch()
    with pytest.raises(RunError, match="no controller runs"):
        OperatorClient("localcan", "hil/0")


def test_a_client_reports_that_the_controller_has_ended(runtime):
    with OperatorChannel("localcan", "hil/0"):
        client = OperatorClient("localcan", "hil/0")
    with client, pytest.raises(RunError, match="does not listen any more: has it ended"):
        client.key()
