"""Nothing compiles inside the loop, which takes as long as fifty ticks, and no type is looked up twice.

Numba recognises numbers and arrays at once; an enumeration's type is looked up at every call, for 0.2 ms.
"""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
from collections import Counter
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
lockstep = Lockstep(cycle, nodes, (BitTiming.of(c.bus),), c.loop.window_s(c.loop.rate_Hz))


def refuse(self, sig):
    raise AssertionError(f"{self.py_func.__name__} compiles in mode {cycle.mode.name}")


def count(self, value):
    looked_up.append(type(value).__name__)
    return look_up(self, value)


dispatcher.Dispatcher.compile = refuse
look_up = dispatcher.Dispatcher.typeof_pyval
dispatcher.Dispatcher.typeof_pyval = count
looked_up = []
seen = []
for tick in range(4000):
    operator = (Operator.RESET,) if tick == 0 else (Operator.STOP,) if tick == 1500 else ()
    lockstep.step((Operator.ENGAGE,) if cycle.mode is Mode.IDLE else operator)
    seen.append(cycle.mode.name)
    if cycle.mode is Mode.PARKED:
        break
assert tick > 2000
assert len(looked_up) < 100, Counter(looked_up)
print(*dict.fromkeys(seen))
"""


MODES = "WAITING IDLE LOADING RELEASING APPROACH TRACKING STOPPING PARKING UNLOADING PARKED"


def test_a_cold_process_compiles_nothing_and_looks_up_no_type_twice():
    modes = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False, timeout=250
    )
    assert modes.returncode == 0, modes.stderr
    assert modes.stdout.strip() == MODES
