"""Python decides in few ticks: in the others the step of the controller is compiled but for its shell."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import pytest

from drivers.signals import Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import load
from hil.app.sim.build import build_lockstep

SHELL = {
    "Cycle.begin",
    "Cycle.step",
    "LegsEnd.begin",
    "new_record",
    "copy_of",
    "row_of",
}
"""What every tick enters between frames in and frames out."""
BRIDGES = {"Control._called.<locals>.called", "Control._stage.<locals>.<lambda>"}
"""What leads to a stage in Python, and is not entered where there is none."""
STAGES = {"Control._advance", "Control._sample", "Control._law.<locals>.effort"}
"""Stages that are not compiled yet, with all that they call. A name is taken out once its stage is."""
FAMILY = {"ControllerEnd.begin", "ControllerEnd._decode", "ControllerEnd._command"}
"""The same of a family of drives whose functions are in Python."""


class Watch:
    """Notes what is entered in a tick. State: the functions of this tick, and the stages of the run."""

    def __init__(self, stages: set[str]) -> None:
        self.stages = stages
        self.entered: set[str] = set()
        self.staged: set[str] = set()
        self._stage: Any = None

    def __call__(self, frame: Any, event: str, _argument: Any) -> None:
        if self._stage is not None:
            if event == "return" and frame is self._stage:
                self._stage = None
            return
        code = frame.f_code
        if event != "call" or code.co_filename == "<string>":  # the constructor of a NamedTuple
            return
        if code.co_qualname in self.stages:
            self._stage = frame
            self.staged.add(code.co_qualname)
        else:
            self.entered.add(code.co_qualname)

    def over(self, function: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Return a function that is watched."""

        def watched(argument: Any) -> Any:
            before = sys.getprofile()
            sys.setprofile(self)
            try:
                return function(argument)
            finally:
                sys.setprofile(before)

        return watched


@pytest.mark.parametrize(("name", "stages"), [("virtual", STAGES), ("desktop", STAGES | FAMILY)])
def test_python_decides_only_while_the_drives_are_waited_for_and_where_a_mode_changes(name, stages):
    c = load(name)
    cycle: Any = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)
    nodes, plant = build_nodes(c)
    lockstep = build_lockstep(c, cycle, nodes)
    watch = Watch(stages)
    cycle.begin = watch.over(cycle.begin)
    cycle.step = watch.over(cycle.step)
    modes, needless = [Mode.WAITING], dict[int, set[str]]()
    decided = 0

    def observe(*_: object) -> None:
        nonlocal decided
        own = watch.entered - SHELL - BRIDGES
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
    assert watch.staged == stages, "a stage that is compiled is not listed any more"


def test_the_shell_is_six_functions_at_most():
    assert len(SHELL) <= 6
