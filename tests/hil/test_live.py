"""Live status line of a run."""

from __future__ import annotations

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
from hil.record.publish import LiveView


def rows(count, **columns):
    result = np.zeros(count, ROW)
    for name, value in columns.items():
        result[name] = value
    return result


class Out(io.StringIO):
    """Output stream that may be a terminal and may be broken."""

    def __init__(self, terminal=False, broken=False):
        super().__init__()
        self.terminal, self.broken, self.tries = terminal, broken, 0

    def isatty(self):
        return self.terminal

    def write(self, text):
        self.tries += 1
        if self.broken:
            raise BrokenPipeError
        return super().write(text)


@pytest.fixture
def now(monkeypatch):
    """Clock of the view, as one number in a list."""
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    return clock


@pytest.mark.parametrize(
    ("done_s", "of_s", "progress"),
    [
        (0.4, 20.0, "                    |   0.4 of 20 s"),
        (5.0, 20.0, "#####               |   5.0 of 20 s"),
        (30.0, 20.0, "####################|  30.0 of 20 s"),
        (12.34, None, "  12.3 s"),
    ],
)
def test_status_line_in_tracking_shows_progress_error_force_stale_and_skipped_ticks(done_s, of_s, progress):
    out = Out()
    given = rows(2, mode=Mode.TRACKING, reference_time_s=done_s, skipped=1, lateness_ns=[41_000, 0])
    given["warnings"] = [int(Warn.STALE | Warn.FORCE_LIMIT), int(Warn.FORCE_LIMIT)]
    given["q"][-1, :2], given["tau"][-1, 1] = (3e-3, -1e-3), -8123.0
    LiveView(out, of_s).show(given)
    line = out.getvalue()
    for words in ("tracking", progress, "leg error  3.000 mm", "force  8123.0 N", "late   41 us"):
        assert words in line, line
    assert "stale 1, skipped 2" in line


@pytest.mark.parametrize(("terminal", "apart_s"), [(True, 0.2), (False, 5.0)])
def test_status_line_is_drawn_every_0_2_s_on_a_terminal_and_else_every_5_s(now, terminal, apart_s):
    out = Out(terminal)
    view = LiveView(out, None)
    drawn = []
    for k in [*range(33), 800, 801, 816]:
        now[0] = k * apart_s / 16
        before = out.tries
        view.show(rows(0))
        view.show(rows(1))
        drawn += [k] if out.tries > before else []
    assert drawn == [0, 16, 32, 800, 816]


@pytest.mark.parametrize("columns", [40, 80])
def test_status_line_fits_in_one_row_of_the_terminal(columns):
    ours, theirs = os.openpty()
    with os.fdopen(theirs, "w", encoding="utf-8") as out:
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        view = LiveView(out, 60.0)
        tracking = rows(1, mode=Mode.TRACKING, reference_time_s=12.3)
        view.show(tracking)
        assert os.read(ours, 65536).decode() == f"\r\x1b[K{view.line(tracking[0])[: columns - 1]}"
    os.close(ours)


def test_broken_terminal_does_not_stop_the_recorder(now):
    out = Out(broken=True)
    view = LiveView(out, None)
    for now[0] in (0.0, 1e6, 2e6):
        view.show(rows(1))
    assert out.tries == 1


@pytest.mark.parametrize("terminal", [True, False])
def test_end_of_a_run_clears_the_status_line_on_a_terminal_only(terminal):
    out = Out(terminal)
    view = LiveView(out, None)
    view.show(rows(1))
    line = out.getvalue()
    view.close()
    assert out.getvalue() == line + ("\r\x1b[K" if terminal else "")
