"""The operator channel of set-points: what it reads, what it answers, whose it is."""

import math
import os
import stat
import tempfile
import threading
import time
from pathlib import Path

import pytest

from drivers.errors import RunError
from drivers.signals import Refusal
from hil.loop.operator_socket import AT_MOST
from hil.loop.setpoints import SetPointSender, SetPointSocket, parse, socket_path
from hil.signals import SetPoint


@pytest.fixture
def runtime(monkeypatch):
    """A runtime folder whose name is short: a socket's path has some 100 characters at most."""
    with tempfile.TemporaryDirectory(prefix="sp") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield folder


@pytest.fixture
def channel(runtime):
    with SetPointSocket("localcan", "hil/0") as channel:
        yield channel


def send(*lines):
    """Send lines from another thread; return it and the list that the answers go to."""
    answers: list[str] = []

    def work():
        with SetPointSender("localcan", "hil/0") as sender:
            answers.extend(sender.send(line) for line in lines)

    thread = threading.Thread(target=work)
    thread.start()
    return thread, answers


def wait_for(channel):
    until = time.monotonic() + 5
    while time.monotonic() < until:
        found = channel.take()
        if found:
            return found
        time.sleep(1e-3)
    raise AssertionError("nothing came")


def test_a_line_is_metres_and_degrees():
    assert parse("0.1 -0.2 1 10 20 -30") == SetPoint(0.1, -0.2, 1.0, math.pi / 18, math.pi / 9, -math.pi / 6)
    assert parse(" 0.1,-0.2,1e0\n") == SetPoint(0.1, -0.2, 1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("", "0 words"),
        ("1 2", "2 words"),
        ("1 2 3 4 5 6 7", "7 words"),
        ("1 2 x", "'1 2 x' is not six numbers, x y z in m"),
        ("1 2 nan", "not finite"),
        ("1 2 3 4 5 inf", "not finite"),
    ],
)
def test_what_is_no_set_point_is_told_what_it_lacks(line, complaint):
    with pytest.raises(ValueError, match=complaint):
        parse(line)


def test_nothing_there_is_nothing_at_once(channel):
    begun = time.perf_counter()
    assert channel.take() == ()
    assert time.perf_counter() - begun < 0.1


def test_a_set_point_arrives_and_its_sender_gets_the_answer(channel):
    thread, answers = send("0 0 1", "0 0 9")
    assert wait_for(channel) == (SetPoint(0, 0, 1, 0, 0, 0),)
    channel.answer([0])
    assert wait_for(channel) == (SetPoint(0, 0, 9, 0, 0, 0),)
    channel.answer([int(Refusal.STROKE)])
    thread.join()
    assert answers == ["taken", "refused: a leg would be outside the soft ends of its stroke"]


def test_nonsense_is_answered_and_does_not_come_through(channel):
    thread, answers = send("nonsense", "0 0 1")
    assert wait_for(channel) == (SetPoint(0, 0, 1, 0, 0, 0),)
    channel.answer([0])
    thread.join()
    assert answers[0].startswith("refused: 1 words; allowed: six numbers")
    assert answers[1] == "taken"


def test_bytes_that_are_no_text_do_no_harm(channel):
    with SetPointSender("localcan", "hil/0") as sender:
        for data in (b"\xff\xfe\x00", b"", b"9" * 4000, "１ ２ ３".encode()):
            sender._socket.send(data)
        assert channel.take() == ()


def test_a_line_that_is_too_long_is_refused_and_not_cut_to_another_pose(channel):
    line = "0 0 1" + " " * 600 + "0 5 10"
    thread, answers = send(line, "0 0 2")
    assert wait_for(channel) == (SetPoint(0, 0, 2, 0, 0, 0),)
    channel.answer([0])
    thread.join()
    assert answers == [
        "refused: longer than 512 bytes; allowed: six numbers, x y z in m and the rotation vector rx ry rz in deg",
        "taken",
    ]


def test_an_answer_that_quotes_many_strange_characters_comes_through_whole(channel):
    line = "a b " + "\u00e9" * 250
    thread, answers = send(line, "0 0 2")
    assert len(wait_for(channel)) == 1
    channel.answer([0])
    thread.join()
    assert answers[0].startswith("refused: 'a b ")
    assert answers[0].endswith("is not six numbers, x y z in m and the rotation vector rx ry rz in deg")


def test_a_socket_that_cannot_be_made_is_said_and_leaves_nothing_open(runtime):
    path = socket_path("localcan", "hil/0")
    path.mkdir()
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(RunError, match=r"set-point socket .*irectory"):
        SetPointSocket("localcan", "hil/0")
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_one_tick_reads_a_few_and_leaves_the_rest_for_the_next(channel):
    with SetPointSender("localcan", "hil/0") as sender:
        for k in range(AT_MOST + 2):
            sender._socket.send(f"{k} 0 1".encode())
        assert [s.x for s in channel.take()] == list(range(AT_MOST))
        channel.answer([0] * AT_MOST)
        assert [s.x for s in channel.take()] == [AT_MOST, AT_MOST + 1]


def test_a_sender_that_has_gone_is_no_trouble(channel):
    with SetPointSender("localcan", "hil/0") as sender:
        sender._socket.send(b"0 0 1")
    assert len(channel.take()) == 1
    channel.answer([0])


def test_a_sender_that_never_reads_its_answers_does_not_hold_up_the_loop(channel):
    with SetPointSender("localcan", "hil/0") as sender:
        for _ in range(3000):
            sender._socket.send(b"0 0 1")
            channel.take()
            begun = time.perf_counter()
            channel.answer([0])
            assert time.perf_counter() - begun < 0.5


def test_the_socket_is_its_owners_alone_and_goes_with_it(channel):
    assert stat.S_IMODE(channel.path.stat().st_mode) == 0o600
    assert stat.S_IMODE(channel.path.parent.stat().st_mode) == 0o700
    assert channel.path.stat().st_uid == os.getuid()
    channel.close()
    assert not channel.path.exists()


def test_one_left_behind_is_replaced(channel):
    with SetPointSocket("localcan", "hil/0") as again:
        thread, answers = send("0 0 1")
        wait_for(again)
        again.answer([0])
        thread.join()
    assert answers == ["taken"]


@pytest.mark.usefixtures("runtime")
def test_without_a_controller_the_sender_says_so():
    with pytest.raises(RunError, match="no controller takes set-points on bus localcan:hil/0"):
        SetPointSender("localcan", "hil/0")
    socket_path("localcan", "hil/0").touch()
    with pytest.raises(RunError, match="no controller takes set-points"):
        SetPointSender("localcan", "hil/0")


def test_a_controller_that_ends_without_an_answer_is_said(channel, monkeypatch):
    monkeypatch.setattr("hil.loop.setpoints.ANSWER_S", 0.05)
    with SetPointSender("localcan", "hil/0") as sender, pytest.raises(RunError, match="did not answer"):
        sender.send("0 0 1")
