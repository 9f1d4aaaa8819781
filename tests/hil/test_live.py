"""The live status line."""

from __future__ import annotations

import errno
import fcntl
import io
import os
import struct
import termios
import time

import numpy as np
import pytest

from drivers.signals import Mode, Warn
from drivers.tick_columns import ROW
from hil.record.live import LiveView


def rows(count, **columns):
    result = np.zeros(count, ROW)
    for name, value in columns.items():
        result[name] = value
    return result


def test_tracking_shows_progress_error_force_and_what_was_missed():
    view = LiveView(io.StringIO(), 20.0)
    view._stale, view._skipped, view._late_us = 3, 2, 41.0
    row = rows(1, mode=Mode.TRACKING, reference_time_s=5.0)[0]
    row["q_d"][4], row["tau"][1] = 2.5e-4, -8123.0
    line = view.line(row)
    assert line.startswith("tracking   #####               |")
    for text in (
        "5.0 of 20 s",
        "leg error  0.250 mm",
        "force  8123.0 N",
        "late   41 us",
        "stale 3, skipped 2",
    ):
        assert text in line, line


def test_counts_over_all_rows_but_draws_seldom():
    out = io.StringIO()
    view = LiveView(out, None)
    for _ in range(10):
        view.show(rows(100, warnings=Warn.STALE, skipped=1, mode=Mode.IDLE))
    assert out.getvalue().count("\n") == 1
    assert view._stale == view._skipped == 1000


@pytest.mark.parametrize("code", [errno.EPIPE, errno.EIO, errno.ENOSPC])
@pytest.mark.parametrize("fails", ["write", "flush"])
def test_a_terminal_that_is_gone_and_a_full_disk_behind_it_do_not_stop_the_recorder(monkeypatch, fails, code):
    out, tries = io.StringIO(), []

    def gone(*_):
        tries.append(code)
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(out, fails, gone, raising=False)
    LiveView(out, None).show(rows(1))
    assert tries == [code]


def test_a_line_has_the_latest_wake_up_since_the_line_before_and_none_from_earlier():
    out = io.StringIO()
    view = LiveView(out, None)

    def show(lateness_us, *, due):
        view._due = 0.0 if due else float("inf")
        view.show(rows(1, lateness_ns=1000 * lateness_us))

    show(5000, due=True)
    show(300, due=False)
    show(700, due=False)
    show(40, due=True)
    show(30, due=True)
    said = [line.partition("late ")[2].partition("us")[0].strip() for line in out.getvalue().splitlines()]
    assert said == ["5000", "700", "30"]


@pytest.fixture
def terminal():
    """A terminal whose width can be set, and what was written to it."""
    ours, theirs = os.openpty()
    with os.fdopen(theirs, "w", encoding="utf-8") as out:

        def wide(columns):
            fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))

        yield out, wide, lambda: os.read(ours, 65536).decode()
    os.close(ours)


@pytest.mark.parametrize(("columns", "most"), [(80, 79), (40, 39), (200, 199), (0, 79)])
def test_a_line_on_a_terminal_stays_in_one_row_of_it_that_the_next_one_rewrites(terminal, columns, most):
    out, wide, written = terminal
    view = LiveView(out, 60.0)
    tracking = rows(1, mode=Mode.TRACKING, reference_time_s=12.3)
    whole = view.line(tracking[0])
    assert 100 < len(whole) < 199
    wide(columns)
    view.show(tracking)
    assert written() == f"\r\x1b[K{whole[:most]}"


def test_a_terminal_that_becomes_narrower_is_asked_again(terminal):
    out, wide, written = terminal
    view = LiveView(out, 60.0)
    tracking = rows(1, mode=Mode.TRACKING, reference_time_s=12.3)
    for columns in (80, 50):
        wide(columns)
        view._due = 0.0
        view.show(tracking)
        assert len(written()) == len("\r\x1b[K") + columns - 1


class Out(io.StringIO):
    """Keeps what was written, and how much of it had been flushed; a terminal if it is told to."""

    def __init__(self, terminal=False, broken=False):
        super().__init__()
        self.terminal, self.broken, self.tries, self.seen = terminal, broken, 0, ""

    def isatty(self):
        return self.terminal

    def write(self, text):
        self.tries += 1
        if self.broken:
            raise BrokenPipeError
        return super().write(text)

    def flush(self):
        self.seen = self.getvalue()


@pytest.mark.parametrize(("terminal", "apart_s"), [(True, 0.2), (False, 5.0)])
def test_a_line_comes_at_once_and_then_five_times_a_second_on_a_terminal_and_every_five_seconds_elsewhere(
    monkeypatch, terminal, apart_s
):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    out = Out(terminal)
    view = LiveView(out, None)
    drawn = []
    for k in range(33):
        now[0] = k * apart_s / 16
        view.show(rows(0))
        before = out.tries
        view.show(rows(1))
        drawn += [k] if out.tries > before else []
        assert out.seen == out.getvalue()
    assert drawn == [0, 16, 32]


@pytest.mark.parametrize(("terminal", "apart_s"), [(True, 0.2), (False, 5.0)])
def test_after_a_long_time_without_a_row_there_is_one_line_and_none_is_made_up_for(
    monkeypatch, terminal, apart_s
):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    out = Out(terminal)
    view = LiveView(out, None)
    lines = []
    for now[0] in (0.0, 50 * apart_s, 50.01 * apart_s, 50.9 * apart_s, 51.01 * apart_s):
        view.show(rows(1))
        lines.append(out.tries)
    assert lines == [1, 2, 2, 2, 3]


def test_a_terminal_that_breaks_is_not_written_to_again(monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    out = Out(broken=True)
    view = LiveView(out, None)
    for _ in range(5):
        view.show(rows(1))
        now[0] += 1e6
    assert out.tries == 1


@pytest.mark.parametrize("terminal", [True, False])
def test_the_end_leaves_no_line_on_a_terminal_and_every_line_elsewhere(terminal):
    out = Out(terminal)
    view = LiveView(out, None)
    view.show(rows(1))
    line = out.getvalue()
    view.end()
    assert out.getvalue() == line + ("\r\x1b[K" if terminal else "")


@pytest.mark.parametrize(
    ("done_s", "of_s", "said"),
    [
        (0.0, 20.0, "tracking                       |   0.0 of 20 s"),
        (0.4, 20.0, "tracking                       |   0.4 of 20 s"),
        (0.6, 20.0, "tracking   #                   |   0.6 of 20 s"),
        (10.0, 20.0, "tracking   ##########          |  10.0 of 20 s"),
        (20.0, 20.0, "tracking   ####################|  20.0 of 20 s"),
        (30.0, 20.0, "tracking   ####################|  30.0 of 20 s"),
        (12.34, None, "tracking     12.3 s"),
        (12.34, 0.0, "tracking     12.3 s"),
    ],
)
def test_a_line_has_the_share_of_the_reference_that_is_done_or_the_time_of_one_without_an_end(
    done_s, of_s, said
):
    (row,) = rows(1, mode=Mode.TRACKING, reference_time_s=done_s)
    row["q"][:2] = [3e-3, -1e-3]
    assert LiveView(Out(), of_s).line(row) == (
        f"{said}  leg error  3.000 mm  force     0.0 N  late    0 us  stale 0, skipped 0"
    )


def test_a_line_outside_of_tracking_has_mode_and_force_and_what_was_counted_since_the_start():
    out = Out()
    view = LiveView(out, 20.0)
    given = rows(4, mode=Mode.IDLE, skipped=[1, 0, 2, 0], lateness_ns=[1000, 9600, 0, 2000])
    given["warnings"][[0, 3]] = int(Warn.STALE), int(Warn.STALE | Warn.FORCE_LIMIT)
    given["warnings"][1] = int(Warn.FORCE_LIMIT)
    given["tau"][-1] = [1.0, -250.25, 3.0, 0.0, 0.0, 200.0]
    given["mode"][-1], given["tau"][:-1] = Mode.HELD, 9e9
    view.show(given)
    assert out.getvalue() == "held       force   250.2 N  late   10 us  stale 2, skipped 3\n"
