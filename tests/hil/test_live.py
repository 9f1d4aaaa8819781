"""The live status line."""

from __future__ import annotations

import fcntl
import io
import os
import struct
import termios

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


def test_a_broken_terminal_does_not_stop_the_recorder():
    class Broken(io.StringIO):
        def write(self, _):
            raise BrokenPipeError

    LiveView(Broken(), None).show(rows(1))


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
