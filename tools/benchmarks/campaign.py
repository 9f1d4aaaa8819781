"""What a second worker gains: rows of a campaign with one worker and with two, in turn, block by block.

    python -m tools.benchmarks.campaign --rows 2000 --block 50

The rows are those of `payload`, 2 s of `virtual` each, as many as asked for: payload, friction, delay,
force loop, encoder noise and fault. They run as `hil campaign` runs them with `--jobs 1` and `--jobs 2`, and
what it does with their lines is done; both tables must be the same to the byte. Beside each block two loops
that touch no memory, one in Python and one in C, run in one process and in two: nothing gets more than that.

Where a block ends, one of two workers has nothing left to do. A campaign has one such end, here each block
has one: half of the time from the last row but one to the last is taken off a block with two workers. The
figure with the mark is without these ends, the one below it as measured.
"""

import argparse
import hashlib
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from drivers.errors import RunError
from hil.app.configuration.yaml_positions import parse
from hil.study import workers
from hil.study.campaign import parquet
from hil.study.campaign.command import line
from hil.study.campaign.plan import Plan, campaign_file, identity, read_plan
from hil.study.campaign.row import Job, not_run, run_row
from hil.study.campaign.store import Store
from tools.benchmarks.figures import Figure, Mark, lines, number
from tools.benchmarks.process import memory_kB

CAMPAIGN = "payload"
LOOPS = 4
"""Of each kind beside a block, so long each:"""
_PYTHON_TURNS, _C_TURNS = 2_000_000, 400_000
Outcomes = Iterator[dict[str, Any]]


class Block(NamedTuple):
    """How long some rows took, s."""

    wall: float
    end: float
    """From the last row but one to the last."""
    own: float
    """Processor time of this process."""


def python_loop(_: int) -> int:
    """Compute something in Python."""
    total = 0
    for k in range(_PYTHON_TURNS):
        total += k & 7
    return total


def c_loop(_: int) -> bytes:
    """Compute something in C."""
    return hashlib.pbkdf2_hmac("sha256", b"six", b"legs", _C_TURNS)


def drawn(rows: int, folder: Path) -> Plan:
    """Return the shipped campaign with that many rows."""
    values: dict[str, Any] = dict(parse(campaign_file(Path(CAMPAIGN)).read_text()).value or {})
    values["sample"]["count"] = rows
    file = folder / f"{CAMPAIGN}.yaml"
    file.write_text(json.dumps(values))
    return read_plan(file)


def measured(plan: Plan, store: Store, outcomes: Outcomes) -> Block:
    """Run a block to its end; its rows go to `store`."""
    columns, ends = parquet.columns(plan), [time.perf_counter()]
    begun, own = ends[0], time.process_time()
    for outcome in outcomes:
        store.add(line(plan, outcome, columns))
        ends.append(time.perf_counter())
    return Block(ends[-1] - begun, ends[-1] - ends[-2], time.process_time() - own)


def in_pool(pool: ProcessPoolExecutor, jobs: Sequence[Job], count: int) -> Outcomes:
    """Yield the outcomes of rows from processes that are there already."""
    # their start is no part of a block
    most = workers.AHEAD * count
    yield from workers.batch(jobs, run_row, not_run, lambda _: nullcontext(pool), most, BrokenProcessPool)


def gain(pool: ProcessPoolExecutor, loop: Callable[[int], object]) -> float:
    """Return how much faster two processes do some loops than one."""
    begun = time.perf_counter()
    list(map(loop, range(LOOPS)))
    one = time.perf_counter()
    list(pool.map(loop, range(LOOPS)))
    return (one - begun) / (time.perf_counter() - one)


def start(job: Job) -> list[Figure]:
    """Start a worker as the first one of a command, and look at what it holds after its rows."""
    begun = time.perf_counter()
    with workers.processes(1, run_row) as pool:
        pid = pool.submit(os.getpid).result()
        took = [time.perf_counter() - begun]
        for _ in range(3):
            begun = time.perf_counter()
            pool.submit(run_row, job).result()
            took.append(time.perf_counter() - begun)
        memory = memory_kB(pid)
    kernels = max(0.0, took[1] - median(took[2:]))
    return [
        Figure(
            "a worker starts in",
            {"": took[0] + kernels},
            "s",
            Mark(2.0),
            note="until its first row can begin",
        ),
        Figure("  of which kernels from the cache", {"": kernels}, "s"),
        Figure("a worker holds", {"": memory["Rss"] / 1024}, "MB", Mark(300.0)),
        Figure("  its share of what is shared", {"": memory["Pss"] / 1024}, "MB"),
    ]


def blocks(plan: Plan, size: int, folder: Path, say: Callable[[str], None]) -> list[Figure]:
    """Run all rows with one worker and with two, in turn. Raises RunError: the tables differ."""
    columns, mark = parquet.columns(plan), identity(plan)
    one: list[Block] = []
    two: list[Block] = []
    loops: dict[str, list[float]] = {"Python": [], "C": []}
    with (
        workers.processes(2, run_row) as pool,
        Store(folder / "one", columns, mark) as alone,
        Store(folder / "two", columns, mark) as both,
    ):
        run_row(plan.job(0))  # what comes first loads kernels, and Parquet
        parquet.write(folder / "first.parquet", columns, [])
        list(in_pool(pool, [plan.job(0)] * 8, 2))
        for first in range(0, len(plan), size):
            jobs = [plan.job(k) for k in range(first, min(first + size, len(plan)))]
            for count in (1, 2) if first // size % 2 else (2, 1):  # a drift falls on both alike
                if count == 1:
                    one.append(measured(plan, alone, map(run_row, jobs)))
                else:
                    two.append(measured(plan, both, in_pool(pool, jobs, 2)))
            loops["Python"].append(gain(pool, python_loop))
            loops["C"].append(gain(pool, c_loop))
            rows = first + len(jobs)
            say(f"row {rows} of {len(plan)}: {gained(one, two):.2f} times one worker")
        tables = {store.finish(store.rows()).read_bytes() for store in (alone, both)}
    if len(tables) != 1:
        raise RunError("the tables of one worker and of two are not the same")
    walls = [sum(block.wall for block in each) for each in (one, two)]
    ratios = sorted(gained([a], [b]) for a, b in zip(one, two, strict=True))
    return [
        Figure("one worker", {"": len(plan) / walls[0]}, "rows/s", note=f"{len(plan)} rows"),
        Figure("two workers", {"": len(plan) / walls[1]}, "rows/s"),
        Figure(
            "gain of the second worker",
            {"": gained(one, two)},
            "times",
            Mark(1.85, at_most=False),
            note=f"blocks of {size} rows {number(ratios[0])} to {number(ratios[-1])}",
        ),
        Figure("  with the end of each block", {"": walls[0] / walls[1]}, "times"),
        *(Figure(f"  of a loop in {name}", {"": median(found)}, "times") for name, found in loops.items()),
        Figure(
            "the command's own work, a row",
            {"": 1e3 * sum(block.own for block in two) / len(plan)},
            "ms",
            note="jobs out, lines in, Parquet; the workers' processors have to do it, too",
        ),
    ]


def gained(one: list[Block], two: list[Block]) -> float:
    """Return how much faster two workers were, without the ends of blocks."""
    return sum(b.wall for b in one) / sum(b.wall - b.end / 2.0 for b in two)


def main() -> None:
    """Measure, and print each figure beside its mark."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", type=int, default=2000)
    parser.add_argument("--block", type=int, default=50, help="rows that run with one worker, then with two")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="benchmark-campaign-") as name:
        folder = Path(name)
        plan = drawn(given.rows, folder)
        print("\n".join(lines("a worker", start(plan.job(0)))) + "\n", flush=True)
        figures = blocks(plan, given.block, folder, lambda text: print(f"... {text}", flush=True))
        print("\n" + "\n".join(lines(f"campaign {CAMPAIGN}", figures)))


if __name__ == "__main__":
    main()
