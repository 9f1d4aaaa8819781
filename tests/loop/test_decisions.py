"""Python decides in few ticks: in the others the controller's step runs compiled, except its shell."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import configs
from drivers.signals import Mode
from hil.app.configuration.changes import without_operator
from hil.app.configuration.configuration import Configuration, load
from hil.loop.tick_row import Given, Ticks
from tests.broad import broad
from tests.loop.bench import bench, changed
from tools.drive_families import FAMILIES, Changes, merged

CONFIGS = Path(str(configs.__path__[0]))
ROOTS = tuple(str(CONFIGS.parent / name) for name in ("drivers", "hil", "plant_fmu"))
SHELL = {
    "Lockstep.advance", "Lockstep._look_at_nodes", "Nodes.address", "TickRow.go", "_looking.<locals>.call",
    "Cycle.pass_on", "Ticks.record",
}  # fmt: skip
"""Functions that a call for many ticks enters."""
MEMORY = {"TickRow._turn_over", "TickRow._hold", "Ticks.__init__", "data_at"}
"""Functions that it also enters when memory is used up."""
DECISIONS = {"Cycle.decide", "Cycle.end_tick"}
CHANGES = 9
"""Mode changes from IDLE to PARKED, one tick each: 0.5 % of 1800 ticks."""
OBSERVED: dict[str, Any] = {
    "estimation": {"wrench": {"source": "observer", "bandwidth_Hz": 5, "bus_ms": 0.5, "drive_lag_ms": 0.8}}
}
TWO_BUSES: Changes = {
    "bus": {
        "channel": None,
        "channels": [{"channel": "a", "legs": [0, 2, 4]}, {"channel": "b", "legs": [1, 3, 5]}],
    }
}
FUSED: dict[str, Any] = {"sensors": {"tracker": {"rate_Hz": 200}}, "estimation": {"pose": "fused"}}


class Watch:
    """Records which functions of the project are entered. State: these."""

    def __init__(self) -> None:
        self.entered: set[str] = set()

    def __call__(self, frame: Any, event: str, _argument: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(ROOTS):
            self.entered.add(code.co_qualname)

    def over(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, with its calls recorded."""

        def watched(*arguments: Any) -> Any:
            before = sys.getprofile()
            sys.setprofile(self)
            try:
                return function(*arguments)
            finally:
                sys.setprofile(before)

        return watched


def shipped(name: str, **sections: Any) -> Configuration:
    c = without_operator(load(name))
    return changed(c, **sections) if sections else c


WITH_PLANT = sorted(path.stem for path in CONFIGS.glob("*.yaml") if "\nplant:" in path.read_text())
CASES: dict[str, Callable[[], Configuration]] = {
    **{name: partial(shipped, name) for name in WITH_PLANT},
    "observer": partial(shipped, "virtual", **OBSERVED),
    "fused pose": partial(shipped, "virtual", **FUSED),
    **{f"{family}, one bus": partial(changed, "desktop", **changes) for family, changes in FAMILIES.items()},
    **{
        f"{family}, two buses": partial(changed, "desktop", **merged(changes, TWO_BUSES))
        for family, changes in FAMILIES.items()
    },
}


QUICK = [
    "virtual",
    "two_buses",
    "virtual-cia402",
    "observer",
    "fused pose",
    "moteus, two buses",
    "odrive, one bus",
]


@pytest.mark.parametrize("name", broad([*QUICK, *(name for name in CASES if name not in QUICK)], len(QUICK)))
def test_compiled_control_loop_calls_python_only_when_the_mode_changes(name):
    """At both ends and on the bus; with sensors only in the cycle, as Python draws their samples."""
    c = CASES[name]()
    watch = Watch()
    modes: list[Mode] = []
    decided = 0

    def take(ticks: Ticks, new: slice, _given: Given) -> None:
        """Count the calls in which Python decides: at most in the last tick of a call."""
        nonlocal decided
        found = ticks.recorded(new)[0]["mode"].tolist()
        moved = [Mode(mode) for mode in found if mode not in {Mode.WAITING, Mode.FAULT}]
        modes.extend(moved)
        others = watch.entered & DECISIONS if name == "fused pose" else watch.entered - SHELL - MEMORY
        decided += bool(moved and others)
        watch.entered.clear()

    with bench(c) as ends:
        lockstep: Any = ends
        lockstep.advance = watch.over(lockstep.advance)
        assert lockstep.run(4000 / c.loop.rate_Hz, None, take=take).success
    assert len(modes) > 500
    assert {Mode.TRACKING, Mode.PARKED} <= set(modes)
    assert 0 < decided <= CHANGES


# -- nothing compiles inside the loop ------------------------------------------------------------------------


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


def test_control_loop_in_a_new_process_uses_cached_kernels_without_compilation():
    modes = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False, timeout=250
    )
    assert modes.returncode == 0, modes.stderr
    assert modes.stdout.strip() == MODES
