"""In simulated time nobody attends a run: none waits for an operator who cannot speak, or for another run."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

import pytest

from drivers.errors import ConfigurationError
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.sim import command as sim
from hil.app.sim.build import build_lockstep
from hil.study.campaign.plan import read_plan
from hil.study.campaign.row import row_configuration
from tests.hil.study.campaign.campaigns import SMALL, written

WAITS: dict[str, dict[str, Any]] = {
    "start": {"start": "asked"},
    "deadman_s": {"deadman_s": 0.2},
    "stays": {"stays": True},
}
SPEEDS = {"setup_speed_m_s": 0.03, "setup_speed_deg_s": 2.0}


def attended(plant: dict[str, Any] | None = None, **operator: Any) -> Configuration:
    """Return `virtual` with a section operator, and a homing file of its emulated drives."""
    changes = {"operator": SPEEDS | operator, "plant": {"homing_file": "parked.yaml"} | (plant or {})}
    return loads(with_changes(load("virtual").text, {"name": "mine"} | changes), "mine.yaml", Path())


class SeenError(Exception):
    """The configuration by which a command would run."""

    def __init__(self, c: Configuration) -> None:
        super().__init__()
        self.c = c


def seen(c: Configuration, *_: Any, **__: Any) -> NoReturn:
    raise SeenError(c)


def campaign(c: Configuration, folder: Path) -> None:
    (folder / "mine.yaml").write_text(c.text)
    text = SMALL.replace("configuration: virtual", "configuration: mine.yaml")
    raise SeenError(row_configuration(read_plan(written(folder, text)).job(0)))


"""What a command calls with the configuration that it runs, and the command."""


def test_a_simulation_in_which_somebody_speaks_keeps_what_the_configuration_asks_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    c = attended(start="asked", deadman_s=0.2, stays=True)
    monkeypatch.setattr(sim, "build_cycle", seen)
    with pytest.raises(SeenError) as found:
        sim.simulate(c, commands=[(1.0, "start")])
    assert found.value.c is c


@pytest.mark.parametrize("key", WAITS)
def test_a_lockstep_that_would_wait_for_nobody_is_refused(key: str) -> None:
    c = attended(**WAITS[key])
    cycle = build_cycle(c, c.loop.rate_Hz, 0.01)
    nodes, plant = build_nodes(c)
    try:
        with pytest.raises(ConfigurationError, match=r"mine\.yaml: operator: nobody gives commands here"):
            build_lockstep(c, cycle, nodes)
        assert build_lockstep(c, cycle, nodes, attended=True).tick == -1
    finally:
        plant.close()
