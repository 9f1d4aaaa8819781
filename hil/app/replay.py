"""`hil replay`: a log's recorded inputs through the same code, compared to the bit."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers.errors import LogError
from hil.app.compose import REFERENCE_PLAN, build_cycle, with_attachments
from hil.app.configuration.configuration import loads
from hil.loop.clock import collector_paused
from hil.loop.replay import Verdict, replay
from hil.record import environment
from hil.record.log import Log


def replay_log(path: Path, progress: Callable[[int], None] | None = None) -> tuple[Verdict, dict[str, Any]]:
    """Replay a log of `hil run` or `hil sim`; return the verdict and its summary.

    `progress` is called with the number of ticks done, every thousand.

    Raises LogError for a file that is no such log.
    """
    log = Log.open(path)
    run = log.metadata.get("hil", {})
    if run.get("kind") not in {"run", "sim"}:
        raise LogError(
            f"{path}: holds a log of kind {run.get('kind')!r}; only logs of `hil run` and `hil sim` replay"
        )
    configuration = loads(log.configuration, f"{path}:config.yaml")
    with tempfile.TemporaryDirectory(prefix="hil-replay-") as folder:
        configuration = with_attachments(configuration, log.attachments, Path(folder))
        plan = log.attachments.get(REFERENCE_PLAN)
        cycle = build_cycle(configuration, float(run["rate_Hz"]), float(run["watchdog_s"]), plan)
    begun = time.perf_counter()
    with collector_paused():
        verdict = replay(log, cycle, progress)
    wall = time.perf_counter() - begun
    result = summary(verdict, wall, verdict.ticks / float(run["rate_Hz"]))
    there, here = log.metadata.get("environment", {}).get("cpu"), environment()["cpu"]
    if there != here:
        result |= {"recorded_on": there, "replayed_on": here}
    result["agrees"] = verdict.exact or (there != here and verdict.equivalent)
    if log.summary.closed != "clean":
        result["remark"] = (
            f"the log was not closed by its run ({log.summary.closed}): it may end before the run did"
        )
    return verdict, result


def summary(verdict: Verdict, wall_s: float, logged_s: float) -> dict[str, Any]:
    """Return a verdict as plain values."""
    return {
        "exact": verdict.exact,
        "equivalent": verdict.equivalent,
        "ticks": verdict.ticks,
        "frames": verdict.frames,
        "different_ticks": verdict.different_ticks,
        "wire_different_ticks": verdict.wire_different_ticks,
        "largest_relative_difference": verdict.largest,
        "first": [str(d) for d in verdict.first],
        "gaps": [f"{count} ticks missing from tick {tick}" for tick, count in verdict.gaps],
        "wall_s": wall_s,
        "times_real_time": logged_s / wall_s if wall_s > 0 else 0.0,
    }
