"""Recorded runs of a bench whose plant is another than its controller believes: loads and friction unknown to it."""

from __future__ import annotations

from pathlib import Path

from drivers.frame_array import received_frames, sent_frames
from hil.app.compose import record
from hil.app.configuration.configuration import Configuration
from hil.app.output import closing
from hil.loop.clock import collector_paused
from plant_fmu.faults.fault import Fault
from tests.loop import bench

changed = bench.changed
"""Sections merged into a configuration, as pasting a block into the file does."""


def run(controller: Configuration, plant: Configuration, log: Path, *faults: Fault) -> None:
    """Record a run of a controller that is configured by one file and a plant that is by another."""
    with (
        bench.bench(controller, *faults, plant_of=plant) as lockstep,
        record(controller, lockstep.cycle, log, "sim", live=False, lockstep=True) as recording,
        collector_paused(),
    ):
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
    assert ending.success, ending.trouble
