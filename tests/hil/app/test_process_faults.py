"""A process that kills, stops and slows itself when its time has come."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil.app.process_faults import ProcessFaults
from plant_fmu.faults.kinds import EncoderFreeze, ProcessSlow

LOOP = """
import sys, time
from hil.app.configuration.fault_words import read_fault
from hil.app.process_faults import ProcessFaults
faults, begun = ProcessFaults([read_fault(sys.argv[1])], 0), time.monotonic()
print("loops", flush=True)
t_ns = 0
while t_ns < 1_000_000_000:
    faults.strike(t_ns)
    t_ns += 10_000_000
    time.sleep(0.005)
print("done", flush=True)
"""


def looping(words: str) -> subprocess.Popen[str]:
    process = subprocess.Popen([sys.executable, "-c", LOOP, words], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "loops\n"
    return process


def test_a_killed_process_is_gone():
    with looping("process_kill at=0.2") as process:
        assert process.wait(30) == -signal.SIGKILL


def test_a_stopped_process_goes_on_after_its_time():
    with looping("process_stop at=0.2 for=0.5") as process:
        stat = Path(f"/proc/{process.pid}/stat")
        stopped = []
        while process.poll() is None:
            if stat.read_text().rpartition(")")[2].split()[0] == "T":
                stopped.append(time.monotonic())
            time.sleep(0.01)
        assert process.returncode == 0
        assert stopped[-1] - stopped[0] == pytest.approx(0.5, abs=0.3)


def test_a_slow_process_is_slow_while_the_fault_is_present():
    faults = ProcessFaults([ProcessSlow(by_ms=50.0, at_s=1.0, for_s=1.0), EncoderFreeze(leg=0)], 0)
    took = []
    for t_s in (0.9, 1.0, 1.5, 2.0, 2.1):
        begun = time.monotonic()
        faults.strike(round(t_s * 1e9))
        took.append(time.monotonic() - begun)
    assert [t >= 0.05 for t in took] == [False, True, True, False, False]
