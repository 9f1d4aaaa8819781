"""Recorded runs whose plant differs from the controller's model: loads and friction unknown to it."""

from __future__ import annotations

from pathlib import Path

from drivers.frame_array import received_frames, sent_frames
from hil.app.compose import record
from hil.app.configuration.configuration import Configuration
from hil.app.output import end_record
from hil.loop.clock import collector_paused
from plant_fmu.faults.fault import Fault
from tests.loop import bench

changed = bench.changed
"""Merges sections into a configuration, as if a block were pasted into the file."""


def run(controller: Configuration, plant: Configuration, log: Path, *faults: Fault) -> None:
    """Record a run with the controller of one configuration and the plant of another."""
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
        recording.close(end_record(ending, ending.trouble))
    assert ending.success, ending.trouble
