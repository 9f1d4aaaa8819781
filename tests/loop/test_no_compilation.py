"""Nothing compiles inside the loop: one compilation takes as long as fifty ticks."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
from drivers.can.bus_time import BitTiming
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import load
from hil.app.sim.lockstep import Lockstep
from drivers.signals import Mode
from hil.signals import Operator
from numba.core import dispatcher

c = load("virtual")
cycle = build_cycle(c, c.loop.rate_Hz, 0.01)
nodes, plant = build_nodes(c)
lockstep = Lockstep(cycle, nodes, BitTiming.of(c.bus), c.loop.window_s(c.loop.rate_Hz))


def refuse(self, sig):
    raise AssertionError(f"{self.py_func.__name__} compiles in mode {cycle.mode.name}")


dispatcher.Dispatcher.compile = refuse
seen = []
for tick in range(4000):
    operator = (Operator.RESET,) if tick == 0 else (Operator.STOP,) if tick == 1500 else ()
    lockstep.step((Operator.ENGAGE,) if cycle.mode is Mode.IDLE else operator)
    seen.append(cycle.mode.name)
    if cycle.mode is Mode.PARKED:
        break
print(*dict.fromkeys(seen))
"""


def test_a_cold_process_compiles_nothing_from_the_first_tick_to_the_last():
    modes = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False, timeout=250
    )
    assert modes.returncode == 0, modes.stderr
    assert modes.stdout.split() == (
        [
            "WAITING",
            "IDLE",
            "LOADING",
            "RELEASING",
            "APPROACH",
            "TRACKING",
            "STOPPING",
            "PARKING",
            "UNLOADING",
            "PARKED",
        ]
    )
