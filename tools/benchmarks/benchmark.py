"""Common data of all benchmark parts: duration, folder, and the simulated run that several parts use."""

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from hil.app.compose import build_cycle
from hil.app.configuration.configuration import Configuration, load
from hil.app.configuration.yaml_positions import parse
from hil.app.sim.command import simulate
from hil.loop.cycle import Cycle
from hil.record.log import Log, Tick

CHANNEL = "hil-benchmark"
"""Name of the benchmark's own bus: a run on the default channel is not disturbed."""
PATIENCE_S = 0.2
"""Stalls up to this long end no run. The host of a virtual machine stops its processor for 5 to 30 ms."""
SPARE_S = 60.0
"""Time, s, by which the path must be longer than the run."""


def patient(name: str, folder: Path, seconds: float) -> Configuration:
    """Write a configuration that tolerates stalls of the host into a folder, and load it.

    The configuration has buses of its own, and a path longer than `seconds`. Raises ConfigurationError if the
    path cannot be so long.
    """
    shipped = load(name)
    values: dict[str, Any] = dict(parse(shipped.text).value or {})
    ticks = round(PATIENCE_S * shipped.loop.rate_Hz)
    values["drives"]["watchdog_ms"] = 1e3 * PATIENCE_S
    values["loop"]["on_stall"] = "fault"
    values["limits"] |= {"stale_fault_ticks": ticks, "missed_stop_ticks": ticks}
    for k, bus in enumerate(values["bus"].get("channels", [values["bus"]])):
        bus["channel"] = f"{CHANNEL}{k}"
    endless = "periods" in values["reference"]
    values["reference"] |= {"periods": None} if endless else {"duration_s": seconds + SPARE_S}
    file = folder / f"{shipped.name}.yaml"
    file.write_text(json.dumps(values, indent=1))
    return load(file)


@dataclass
class Benchmark:
    """Settings and shared data of a benchmark. Mutable state: the simulated run, made at its first use."""

    folder: Path
    """Folder for logs; on a disk, so that the recorder waits as in real runs."""
    seconds: float
    """Duration of each run, in real time or simulated; a shorter path ends it earlier."""
    say: Callable[[str], None]
    """Output function for progress."""

    @cached_property
    def configuration(self) -> Configuration:
        """Shipped configuration `virtual`."""
        return load("virtual")

    def cycle(self) -> Cycle:
        """New controller of the shipped configuration `virtual`."""
        c = self.configuration
        return build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3)

    @cached_property
    def simulated(self) -> dict[str, Any]:
        """Summary of a recorded `hil sim virtual`, without the replay at its end."""
        self.say("hil sim virtual")
        log = self.folder / "sim.mcap"
        return simulate(self.configuration, log=log, duration_s=self.seconds, check_replay=False)

    @cached_property
    def ticks(self) -> list[Tick]:
        """Recorded ticks of the simulated run, in memory."""
        return list(Log.open(Path(self.simulated["log"])).ticks())


def cpu_s(pid: int) -> float:
    """Processor time of a process so far, user and system, s; resolution 10 ms."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_MB(pid: int) -> float:
    """Resident memory of a process, MB (1024^2 bytes). Raises OSError if the process has ended."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024.0
    raise ProcessLookupError(f"process {pid} has ended")
