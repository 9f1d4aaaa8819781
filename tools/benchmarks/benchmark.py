"""What all parts share: how long, where to, and the one simulated run that several of them use."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from hil.app.configuration.configuration import Configuration, load
from hil.app.configuration.yaml_positions import parse
from hil.app.sim.command import simulate
from hil.record.log import Log, Tick
from tools.benchmarks.patience import make_patient

CONFIGURATION = "virtual"
CHANNEL = "hil-benchmark"
"""A bus of our own: a run on the default channel is not disturbed."""


@dataclass
class Held:
    """Recorded ticks in memory, for `hil.loop.replay.replay`."""

    entries: list[Tick]

    def ticks(self) -> Iterator[Tick]:
        """Return the ticks."""
        return iter(self.entries)


@dataclass
class Benchmark:
    """One run of the benchmark. Mutable state: the simulated run, once somebody asked for it."""

    folder: Path
    """For logs; on a disk, so that the recorder's waits are real."""
    seconds: float
    """Of the run in real time."""
    memory_minutes: float
    """Over which the daemon's memory is watched."""
    say: Callable[[str], None]
    """Where progress goes."""

    @cached_property
    def configuration(self) -> Configuration:
        """The shipped configuration."""
        return load(CONFIGURATION)

    @cached_property
    def endless(self) -> Configuration:
        """The same, patient, on a bus of our own and a path without end; a file: the plant reads it, too."""
        values: dict[str, Any] = dict(parse(self.configuration.text).value or {})
        values["bus"]["channel"] = CHANNEL
        values["reference"]["periods"] = None
        make_patient(values, self.configuration.loop.rate_Hz)
        file = self.folder / "benchmark.yaml"
        file.write_text(json.dumps(values, indent=1))
        return load(file)

    @cached_property
    def simulated(self) -> dict[str, Any]:
        """The summary of `hil sim` of the shipped configuration, recorded but not replayed."""
        self.say("hil sim virtual, ten periods of the path")
        return simulate(self.configuration, log=self.folder / "sim.mcap", check_replay=False)

    @cached_property
    def held(self) -> Held:
        """The ticks of that run."""
        return Held(list(Log.open(Path(self.simulated["log"])).ticks()))
