"""A run in lockstep on a plant that is not what the controller believes: laden, or with friction it has not heard of."""

from __future__ import annotations

from pathlib import Path

import yaml

from drivers.frame_array import received_frames, sent_frames
from hil.app.compose import build_cycle, build_nodes, record
from hil.app.configuration.configuration import Configuration, loads
from hil.app.output import closing
from hil.app.sim.build import build_lockstep
from hil.loop.clock import collector_paused
from plant_fmu.faults.plan import FaultPlan


def changed(configuration: Configuration, **sections: object) -> Configuration:
    """Return it with keys merged into its sections, as pasting a block into the file does."""

    def merge(into: dict[str, object], keys: dict[str, object]) -> None:
        for key, value in keys.items():
            inner = into.get(key)
            if isinstance(value, dict) and isinstance(inner, dict) and "type" not in value:
                merge(inner, value)
            else:
                into[key] = value

    document = yaml.safe_load(configuration.text)
    merge(document, sections)
    return loads(yaml.safe_dump(document, sort_keys=False), configuration.source, configuration.folder)


def run(controller: Configuration, plant: Configuration, log: Path, faults: FaultPlan | None = None) -> None:
    """Record a run of a controller that is configured by one file and a plant that is by another."""
    c = controller
    cycle = build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3)
    nodes, physics = build_nodes(plant, faults)
    try:
        lockstep = build_lockstep(c, cycle, nodes)
        with record(c, cycle, log, "sim", live=False, lockstep=True) as recording, collector_paused():
            ending = lockstep.run(
                None,
                lambda inp, opening, out: recording.tick(
                    out.row,
                    received_frames(inp.frames),
                    sent_frames(opening) + sent_frames(out.frames),
                    inp.operator,
                    setpoints=inp.setpoints,
                ),
                recording.event,
            )
            recording.close(closing(ending, ending.trouble))
    finally:
        physics.close()
    assert ending.success, ending.trouble
