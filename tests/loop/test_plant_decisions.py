"""The plant's end enters Python in few ticks: while drives are set up, and where one of them begins or ends."""

from __future__ import annotations

import sys
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

import plant_fmu
from drivers.signals import Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import loads
from hil.app.sim.build import build_lockstep
from tools.drive_families import FAMILIES, merged

ROOT = str(Path(plant_fmu.__path__[0]).parent)
SHELL = {"Nodes.advance"}
"""What every tick enters."""
TWO_BUSES = {
    "bus": {
        "channel": None,
        "channels": [{"channel": "a", "legs": [0, 2, 4]}, {"channel": "b", "legs": [1, 3, 5]}],
    }
}


@pytest.mark.parametrize("buses", [{}, TWO_BUSES], ids=["one bus", "two buses"])
@pytest.mark.parametrize("name", FAMILIES)
def test_no_python_is_entered_at_the_plants_end_in_a_steady_tick(name, buses):
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    c = loads(with_changes(text, merged(FAMILIES[name], buses)), "desktop")
    cycle = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)
    nodes, plant = build_nodes(c)
    lockstep = build_lockstep(c, cycle, nodes)
    advance, entered = nodes.advance, set()

    def note(frame: Any, event: str, _argument: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(ROOT):
            entered.add(code.co_qualname)

    def watched(*given: Any) -> Any:
        before = sys.getprofile()
        sys.setprofile(note)
        try:
            return advance(*given)
        finally:
            sys.setprofile(before)

    watching: Any = nodes
    watching.advance = watched
    modes, needless, lived = [Mode.WAITING, Mode.WAITING], dict[int, set[str]](), set[str]()

    def observe(*_: object) -> None:
        lived.update(entered)
        own = entered - SHELL
        entered.clear()
        modes.append(cycle.mode)
        # what the controller commands at a change acts in the next tick
        if own and modes[-3] is modes[-2] is cycle.mode is not Mode.WAITING:
            needless[lockstep.tick] = own

    try:
        ending = lockstep.run(1.0, observe)
    finally:
        plant.close()
    assert ending.success
    assert not needless
    assert lived >= SHELL
    assert {Mode.TRACKING, Mode.PARKED} & set(modes)
