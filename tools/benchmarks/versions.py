"""Comparison of two versions of the project: time of a tick in `hil sim` and in a replay.

    python -m tools.benchmarks.versions OLD NEW --duration 10 --rounds 5

OLD and NEW are checkouts. Each round starts one process for each, with this Python and its libraries. The
process runs the configuration in lockstep without a recorder, then replays a recorded run from memory. The
figure is the median of the fastest tenth of all blocks of 128 ticks on the path.
"""

import argparse
import gc
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from types import SimpleNamespace
from typing import Any

BLOCK = 128
"""Ticks of a block: a multiple of the ticks that a version may compute in one call."""
KINDS = ("lockstep", "replay")


class Stamps:
    """Time and mode at the end of each block of ticks. Mutable state: these, and the number of ticks."""

    def __init__(self) -> None:
        self.ticks = 0
        self.taken: list[tuple[int, int]] = []

    def tick(self, row: Any, count: int = 1) -> None:
        """Count ticks; `row` is the row of the last one."""
        self.ticks += count
        if self.ticks % BLOCK == 0:
            self.taken.append((time.perf_counter_ns(), int(row["mode"])))

    def blocks(self, mode: int) -> list[float]:
        """Time of a tick, us, in each block that begins and ends in `mode`."""
        pairs = zip(self.taken, self.taken[1:], strict=False)
        return [(end - begun) * 1e-3 / BLOCK for (begun, a), (end, b) in pairs if a == b == mode]


def measure(configuration: str, duration_s: float) -> dict[str, list[float]]:
    """Run and replay with the version in PYTHONPATH; return the time of a tick in all blocks, us."""
    from drivers.signals import Mode  # noqa: PLC0415
    from hil.app.compose import build_cycle, build_nodes  # noqa: PLC0415
    from hil.app.configuration.configuration import load  # noqa: PLC0415
    from hil.app.sim.build import build_lockstep  # noqa: PLC0415
    from hil.app.sim.command import simulate  # noqa: PLC0415
    from hil.loop.replay import replay  # noqa: PLC0415
    from hil.record.log import Log  # noqa: PLC0415

    c = load(configuration)
    again, cycle = (build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3) for _ in range(2))
    stamps = {kind: Stamps() for kind in KINDS}
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "run.mcap"
        simulate(c, log=log, duration_s=duration_s, check_replay=False)
        entries = list(Log.open(log).ticks())

    def ticks() -> Iterator[Any]:
        for entry in entries:
            stamps["replay"].tick(entry.row)
            yield entry

    def take(ticks: Any, new: slice, _given: Any) -> None:
        rows = ticks.recorded(new)[0]
        stamps["lockstep"].tick(rows[-1], len(rows))

    held: Any = SimpleNamespace(ticks=ticks)
    nodes, plant = build_nodes(c)
    gc.freeze()
    gc.disable()
    try:
        build_lockstep(c, cycle, nodes).run(duration_s, None, take=take)
    finally:
        plant.close()
    if different := replay(held, again).different_ticks:
        sys.exit(f"{different} ticks of the replay differ")
    return {kind: found.blocks(Mode.TRACKING) for kind, found in stamps.items()}


def measured(checkout: Path, configuration: str, duration_s: float) -> dict[str, list[float]]:
    """Result of `measure` for the sources in `checkout`, in a process of its own."""
    command = [sys.executable, "-P", __file__, "--configuration", configuration]
    command += ["--duration", str(duration_s)]
    own = os.environ | {"PYTHONPATH": str(checkout.resolve())}
    done = subprocess.run(command, env=own, stdout=subprocess.PIPE, check=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def compare(checkouts: Sequence[Path], run: tuple[str, float], rounds: int) -> Iterator[str]:
    """Measure two versions in turn; yield table cells for each kind: us of a tick, ratio of the speeds."""
    found = [[measured(each, *run) for each in checkouts] for _ in range(rounds)]
    for kind in KINDS:
        quietest = [[_quietest(each[kind]) for each in both] for both in found]
        old, new = map(median, zip(*quietest, strict=True))
        ratios = sorted(a / b for a, b in quietest)
        yield f"{old:.1f}, {new:.1f} | {old / new:.2f} ({ratios[0]:.2f} to {ratios[-1]:.2f})"


def _quietest(us: list[float]) -> float:
    """Median of the fastest tenth of the times of blocks, us."""
    return median(sorted(us)[: max(1, len(us) // 10)])


def main() -> None:
    """Measure both versions in turn; print both figures, and their ratio with its range over the rounds."""
    parser = argparse.ArgumentParser(description="Compare the time per tick of two versions, run in turn.")
    parser.add_argument(
        "checkouts", nargs="*", type=Path, help="two folders; without any: JSON of this version"
    )
    parser.add_argument("--configuration", default="virtual")
    parser.add_argument("--duration", type=float, default=10.0, metavar="S", help="seconds, at least 3")
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    if not given.checkouts:
        print(json.dumps(measure(given.configuration, given.duration)))
        return
    print("| | lockstep, us | times | replay, us | times |\n|---|---|---|---|---|")
    cells = compare(given.checkouts, (given.configuration, given.duration), given.rounds)
    print(f"| `{given.configuration}` | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
