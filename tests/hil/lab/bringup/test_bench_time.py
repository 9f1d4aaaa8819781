"""A bench keeps up with its bus while a drive controls by itself, though its plant is stepped each 100 us then."""

import contextlib
import time
from statistics import median

import numpy as np
import pytest

from drivers.signals import DriveMode, DriveState
from hil.app.compose import build_protocol
from hil.lab.bringup.drives import Drives
from hil.lab.bringup.machine import bringup_rate
from hil.lab.bringup.rehearsal import BenchLine, build_bench, mounted
from plant_fmu.rehearsal.wiring import Wiring
from tests.hil.lab.bringup.families import family

PERIOD_NS = 2_500_000
ADDITIONS = 1000
"""Of six numbers by NumPy, which take longer than a tick of 25 steps: 0.5 ms where that takes 0.08 ms compiled on
trestles and 0.12 ms with the platform. With one NumPy call an operation the tick takes 1.1 and 0.65 ms, and answers
miss their window."""


def additions_s():
    """Return the processor time of the additions, s: how fast this machine is now."""
    a, b = np.ones(6), np.ones(6)
    began = time.process_time()
    for _ in range(ADDITIONS):
        a + b
    return time.process_time() - began


@pytest.mark.parametrize("hung", [False, True], ids=["trestles", "platform"])
def test_a_tick_in_which_a_drive_damps_takes_a_fraction_of_its_period(hung):
    c = family("moteus_zero_velocity")
    bench = build_bench(c, Wiring())
    with contextlib.closing(bench.cables):
        if hung:
            bench.cables.exchange(mounted(c, bench.wiring))
        nodes = bench.nodes
        drives = Drives(build_protocol(c), BenchLine(nodes, bringup_rate(c)), 1e-3 * c.drives.watchdog_ms)
        drives.prepare(0)
        for _ in range(4):
            drives.step(DriveMode.RUN, 0)
        assert nodes.snapshot().state[0] == DriveState.RUN
        began = (drives.tick + 20) * PERIOD_NS
        nodes.step(began, ())
        shares = []
        for k in range(1, 101):
            start = time.process_time()
            nodes.step(began + k * PERIOD_NS, ())
            took = time.process_time() - start
            shares.append(took / additions_s())
        end = nodes.snapshot()
    assert (end.state[0], end.brake[0]) == (DriveState.FAULT, 0.0)  # it has damped all the time
    assert median(shares) < 1.0
