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
TWO_BUSES = "two_buses"
SPARE_S = 60.0
"""Of a path after the run that is measured on it."""
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
    """Of each run, in real time and simulated; a path that is shorter ends it."""
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
        values = self._patient(self.configuration)
        values["bus"]["channel"] = CHANNEL
        values["reference"]["periods"] = None
        return self._filed("benchmark", values)

    @cached_property
    def two_buses(self) -> Configuration:
        """The shipped configuration of two buses, likewise; its path is longer than the run."""
        values = self._patient(load(TWO_BUSES))
        for k, each in enumerate(values["bus"]["channels"]):
            each["channel"] = f"{CHANNEL}{k}"
        values["reference"]["duration_s"] = self.seconds + SPARE_S
        return self._filed(TWO_BUSES, values)

    @staticmethod
    def _patient(c: Configuration) -> dict[str, Any]:
        values: dict[str, Any] = dict(parse(c.text).value or {})
        make_patient(values, c.loop.rate_Hz)
        return values

    def _filed(self, name: str, values: dict[str, Any]) -> Configuration:
        file = self.folder / f"{name}.yaml"
        file.write_text(json.dumps(values, indent=1))
        return load(file)

    @cached_property
    def simulated(self) -> dict[str, Any]:
        """The summary of `hil sim` of the shipped configuration, recorded but not replayed."""
        self.say("hil sim virtual")
        return simulate(
            self.configuration, log=self.folder / "sim.mcap", duration_s=self.seconds, check_replay=False
        )

    @cached_property
    def held(self) -> Held:
        """The ticks of that run."""
        return Held(list(Log.open(Path(self.simulated["log"])).ticks()))
