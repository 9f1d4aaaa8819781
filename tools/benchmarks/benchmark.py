"""Common data of the benchmark parts: a simulated run that several use; figures and their limits (marks)."""

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

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


FAILED, EARLY = "failed", "ended early"
"""Names of the figures that state why a part was not measured, or not to its end."""


class Mark(NamedTuple):
    """Limit for all values of a figure; it applies to two idle cores with SCHED_FIFO."""

    limit: float
    at_most: bool = True
    """True: an upper limit; False: a lower limit."""

    def __str__(self) -> str:
        return f"{'<=' if self.at_most else '>='} {self.limit:g}"


@dataclass(frozen=True)
class Figure:
    """One line of results: values of one quantity; without values the note states why."""

    name: str
    values: Mapping[str, float] = field(default_factory=dict)
    """Name of a value (median, p99, max; empty for a single value) -> value."""
    unit: str = ""
    mark: Mark | None = None
    note: str = ""

    @property
    def met(self) -> bool | None:
        """True if every value keeps the limit `mark`, which NaN never does; None without mark or values."""
        if self.mark is None or not self.values:
            return None
        limit, at_most = self.mark
        return all(value <= limit if at_most else value >= limit for value in self.values.values())

    def text(self) -> str:
        """Text of the values with their unit, to three digits."""
        parts = (f"{name} {_number(value)}".strip() for name, value in self.values.items())
        return f"{', '.join(parts)} {self.unit}".strip() if self.values else ""

    def remark(self) -> str:
        """Text of the limit `mark`, of whether it is met, and of the note."""
        outcome = {True: "met", False: "not met", None: "not measured"}[self.met]
        mark = "" if self.mark is None else f"mark {self.mark} {self.unit}".rstrip() + f": {outcome}"
        return "; ".join(filter(None, (mark, self.note)))

    def plain(self) -> dict[str, Any]:
        """Figure as plain values for a JSON file."""
        result: dict[str, Any] = {"name": self.name, "values": dict(self.values), "unit": self.unit}
        if self.mark is not None:
            result |= {"mark": str(self.mark), "met": self.met}
        return result | ({"note": self.note} if self.note else {})


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def spread(values: ArrayLike, *, largest: bool = False, scale: float = 1e-3) -> dict[str, float]:
    """Median, 99th percentile and, with `largest`, maximum of values times `scale` (default: ns to us)."""
    x = np.asarray(values, np.float64) * scale
    if not x.size:
        return {}
    median, p99 = np.percentile(x, [50, 99]).tolist()
    return {"median": median, "p99": p99} | ({"max": float(x.max())} if largest else {})


def lines(name: str, figures: list[Figure]) -> list[str]:
    """Lines of text about a benchmark part: its name, then one line for each figure, in columns."""
    first = max((len(f.name) for f in figures), default=0)
    second = max((len(f.text()) for f in figures), default=0)
    return [name, *(f"  {f.name:<{first}}  {f.text():<{second}}  {f.remark()}".rstrip() for f in figures)]
