"""A bench keeps up with its bus while a drive controls by itself, though its plant is stepped each 100 us then."""

import contextlib
import time
from itertools import pairwise

import pytest

from drivers.signals import DriveMode, DriveState
from hil.app.bringup.machine import bringup_rate
from hil.app.bringup.rehearsal import BenchLine, build_bench, mounted
from hil.app.compose import build_protocol
from hil.bringup.drives import Drives
from plant_fmu.rehearsal.wiring import Wiring
from tests.hil.bringup.families import family

PERIOD_NS = 2_500_000
MOST_s = 0.4e-3
"""Of processor time for a tick of 25 steps. Compiled, it takes 0.08 ms on trestles and 0.12 ms with the platform;
with one NumPy call an operation it takes 1.1 and 0.65 ms, and answers miss their window."""


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
        instants = [time.process_time()]
        for k in range(1, 101):
            nodes.step(began + k * PERIOD_NS, ())
            if k % 20 == 0:
                instants.append(time.process_time())
        end = nodes.snapshot()
    assert (end.state[0], end.brake[0]) == (DriveState.FAULT, 0.0)  # it has damped all the time
    assert min(b - a for a, b in pairwise(instants)) / 20 < MOST_s
