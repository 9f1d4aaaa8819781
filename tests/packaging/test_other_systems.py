"""`hil` without what only Linux has: simulation, replay and report; the rest is refused in one line.

A child process removes the calls that Windows lacks. It is no Windows: numbers, paths and the FMU are Linux's.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hil import Log, sim

ROOT = Path(__file__).resolve().parents[2]
WITHOUT = """
import ctypes, importlib.metadata, multiprocessing.connection, os, select, selectors, signal, socket, subprocess, sys, time
import can, cantools, click, fmpy.fmi2, fmpy.fmi3, mcap.reader, mcap_protobuf.writer, numba.typed, numpy, pydantic
for module in ("fcntl", "grp", "pwd", "resource", "termios", "tty"):
    sys.modules[module] = None
pair, unix = socket.socketpair, socket.AF_UNIX
LACKING = {
    os: '''SCHED_BATCH SCHED_FIFO SCHED_OTHER SCHED_RESET_ON_FORK SCHED_RR O_CLOEXEC O_DIRECTORY O_NOCTTY O_NOFOLLOW
        O_NONBLOCK fdatasync fork getuid memfd_create pidfd_open posix_fallocate pwrite register_at_fork
        sched_getaffinity sched_getparam sched_getscheduler sched_param sched_setaffinity sched_setscheduler
        set_blocking uname''',
    signal: "SIGALRM SIGHUP SIGKILL SIGPIPE SIG_BLOCK SIG_SETMASK pthread_sigmask setitimer",
    socket: "AF_CAN AF_NETLINK AF_UNIX CAN_RAW SOCK_CLOEXEC SOCK_SEQPACKET",
    select: "epoll poll",
    time: "CLOCK_MONOTONIC clock_gettime clock_gettime_ns",
}
for module, names in LACKING.items():
    for name in names.split():
        if hasattr(module, name):
            delattr(module, name)
# multiprocessing waits and connects by other calls on Windows
multiprocessing.connection._WaitSelector, socket.socketpair = selectors.SelectSelector, lambda: pair(unix)
class CDLL(ctypes.CDLL):
    def __init__(self, name, *more, **options):
        if name is None:
            raise TypeError("Windows has no library of all symbols")
        super().__init__(name, *more, **options)
ctypes.CDLL = CDLL
"""
SIMULATED = """
import hil
run = hil.sim("virtual", log="other.mcap", duration_s=0.2)
assert run.success and run.summary["replay"]["agrees"], run.summary
from hil.cli import main
for words in ("replay other.mcap", "report other.mcap", "check virtual", "plot other.mcap -c tau"):
    try:
        main(words.split(), prog_name="hil")
    except SystemExit as end:
        assert not end.code, (words, end.code)
"""
COMMAND = "sys.platform = 'win32'; from hil.cli import main; main(sys.argv[1:], prog_name='hil')"


def child(folder, script, *words):
    """Run a script where the calls of LACKING are missing."""
    return subprocess.run(
        [sys.executable, "-c", WITHOUT + script, *words],
        cwd=folder, capture_output=True, text=True, timeout=240, check=False,
    )  # fmt: skip


def test_simulation_replay_and_report_run_without_calls_of_linux(tmp_path):
    done = child(tmp_path, SIMULATED)
    assert done.returncode == 0, done.stderr
    here = sim("virtual", log=tmp_path / "here.mcap", duration_s=0.2).log.rows()
    there = Log(tmp_path / "other.mcap").rows()
    assert len(here) == len(there) > 500
    assert all((here[name] == there[name]).all() for name in ("q", "tau"))
    assert (tmp_path / "other.html").stat().st_size > 10_000


@pytest.mark.parametrize("words", ["run virtual --plant", "plant virtual", "ctl virtual hold", "watch"])
def test_real_time_commands_are_refused_in_one_line_elsewhere(words, tmp_path):
    done = child(tmp_path, COMMAND, *words.split())
    assert done.returncode == 2, done.stderr
    assert "needs Linux" in done.stderr
    assert done.stderr.count("\n") == 1
