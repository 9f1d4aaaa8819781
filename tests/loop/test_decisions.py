"""Python decides in few ticks: in the others the step of the controller is compiled but for its shell."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import configs
from drivers.signals import Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.unattended import without_operator
from hil.app.sim.build import build_lockstep

CONFIGS = Path(str(configs.__path__[0]))
SHELL = {"Cycle.begin", "Cycle.step", "new_record", "copy_of", "row_of"}
"""What every tick enters between frames in and frames out, but for the first frames of a tick."""
LOCKSTEP = {"Lockstep.step", "Lockstep._exchange", "Nodes.advance"}
"""What a tick of both ends enters besides: of the bus, and of the drives and the plant."""
BEGIN = {"LegsController.begin", "MotorsEnd.begin", "Cia402End.begin"}
"""What makes these, with all that it calls: one of them in a run."""
CHANGES = 9
"""Changes of the mode from IDLE to PARKED, in a tick each: 0.5 % of 1800 ticks."""
OBSERVED = "\nestimation: {wrench: {source: observer, bandwidth_Hz: 5, bus_ms: 0.5, drive_lag_ms: 0.8}}\n"
FUSED = "\nsensors: {tracker: {rate_Hz: 200}}\nestimation: {pose: fused}\n"


class Watch:
    """Notes what is entered in a tick. State: the functions of this tick, and what began the run."""

    def __init__(self) -> None:
        self.entered: set[str] = set()
        self.begun: set[str] = set()
        self._beginning: Any = None

    def __call__(self, frame: Any, event: str, _argument: Any) -> None:
        if self._beginning is not None:
            if event == "return" and frame is self._beginning:
                self._beginning = None
            return
        code = frame.f_code
        if event != "call" or code.co_filename == "<string>":  # the constructor of a NamedTuple
            return
        if code.co_qualname in BEGIN:
            self._beginning = frame
            self.begun.add(code.co_qualname)
        else:
            self.entered.add(code.co_qualname)

    def over(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that is watched."""

        def watched(*arguments: Any) -> Any:
            before = sys.getprofile()
            sys.setprofile(self)
            try:
                return function(*arguments)
            finally:
                sys.setprofile(before)

        return watched


@pytest.mark.parametrize(
    ("name", "block"),
    [("virtual", ""), ("desktop", ""), ("virtual", OBSERVED), ("virtual", FUSED)],
    ids=["virtual", "desktop", "observer", "fused pose"],
)
def test_python_decides_only_while_the_drives_are_waited_for_and_where_a_mode_changes(name, block):
    c = load(name)
    c = loads(c.text + block, c.name, c.folder)
    watch = Watch()
    cycle: Any = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)
    nodes, plant = build_nodes(c)
    lockstep = build_lockstep(c, cycle, nodes)
    cycle.begin = watch.over(cycle.begin)
    cycle.step = watch.over(cycle.step)
    modes, needless = [Mode.WAITING], dict[int, set[str]]()
    decided = 0

    def observe(*_: object) -> None:
        nonlocal decided
        own = watch.entered - SHELL
        watch.entered.clear()
        modes.append(cycle.mode)
        decided += bool(own)
        if own and modes[-2] is cycle.mode is not Mode.WAITING:
            needless[lockstep.tick] = own

    try:
        ending = lockstep.run(1.5, observe)
    finally:
        plant.close()
    assert ending.success
    assert not needless
    assert {Mode.TRACKING, Mode.PARKED} <= set(modes)
    assert 0 < decided <= modes.count(Mode.WAITING) + 9
    assert len(watch.begun) == 1


@pytest.mark.parametrize(
    "name", sorted(path.stem for path in CONFIGS.glob("*.yaml") if "\nplant:" in path.read_text())
)
def test_both_ends_and_the_bus_decide_in_python_only_where_a_mode_changes(name):
    c = without_operator(load(name))
    watch = Watch()
    cycle = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)
    nodes, plant = build_nodes(c)
    lockstep: Any = build_lockstep(c, cycle, nodes)
    lockstep.step = watch.over(lockstep.step)
    decided: list[bool] = []

    def observe(*_: object) -> None:
        if cycle.mode not in {Mode.WAITING, Mode.FAULT}:
            decided.append(bool(watch.entered - SHELL - LOCKSTEP))
        watch.entered.clear()

    try:
        assert lockstep.run(4000 / c.loop.rate_Hz, observe).success
    finally:
        plant.close()
    assert len(decided) > 500
    assert 0 < sum(decided) <= CHANGES
