"""Removes old logs to make room for a new one, within `recording.budget_GB`.

Only logs with dated names of the same configuration in its recordings folder are counted and removed. A log
with a name given by the user is never touched.
"""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from drivers.errors import HilError, LogError
from hil.app.configuration.configuration import Configuration
from hil.record.log import Log
from hil.record.mcap_file import being_written
from hil.record.schema import SUMMARY

TICK_BYTES = 2000
"""Upper bound of the log size of a tick; 0.8 to 1.1 kB were measured on the shipped configurations."""
GB = 1_000_000_000


def needed_bytes(c: Configuration, path_s: float | None, duration_s: float | None) -> int:
    """Upper bound of the size of a run's log, bytes; 0 for a run without a known end.

    path_s, duration_s: of the reference and of the run, s. Approach, brake tests and parking count as 30 s.
    """
    ends = [s for s in (path_s, duration_s) if s is not None]
    return round((min(ends) + 30.0) * c.loop.rate_Hz * TICK_BYTES) if ends else 0


def make_room(c: Configuration, needed: int, given: Path | None = None) -> list[str]:
    """Remove old logs until budget and disk have room for `needed` bytes; return the removed paths.

    The oldest logs are removed first: those without a fault, then the others. The newest run is kept, and so
    is every log that is still being written. Without `recording.budget_GB` nothing is removed. The folder
    must exist. Raises LogError: the disk or the budget is too small for the run.
    """
    folder = Path(c.recording.folder) if given is None else given.parent
    budget = None if c.recording.budget_GB is None else round(c.recording.budget_GB * GB)
    removed: list[str] = []
    if budget is not None and given is None:
        if needed > budget:
            raise LogError(
                f"recording.budget_GB {c.recording.budget_GB:g}: this run may write {needed / GB:.3g} GB; "
                "raise it, or end the run earlier with --duration"
            )
        runs = dated_logs(folder, c.name)
        sizes = {path: _size(path) for logs in runs.values() for path in logs}
        total = sum(sizes.values())
        for path in _removable(list(runs.values())):
            if total + needed <= budget and shutil.disk_usage(folder).free >= needed:
                break
            path.unlink(missing_ok=True)
            total -= sizes[path]
            removed.append(str(path))
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise LogError(
            f"{folder}: {free / GB:.3g} GB are free, and this run may write {needed / GB:.3g} GB: make room, "
            "end the run earlier with --duration, or let recording.budget_GB remove old logs"
        )
    return removed


def dated_logs(folder: Path, name: str) -> dict[tuple[str, int], list[Path]]:
    """Logs with dated names of a configuration, by run, the oldest first.

    A run is (date, number on that date); it has its own log, its plant's log, or both.
    """
    pattern = re.compile(re.escape(name) + r"-(\d{8}T\d{6})(?:-(\d+))?(?:-plant)?\.mcap")
    runs: dict[tuple[str, int], list[Path]] = {}
    for path in sorted(folder.glob("*.mcap"), key=lambda path: path.stem):
        if found := pattern.fullmatch(path.name):
            runs.setdefault((found[1], int(found[2] or 1)), []).append(path)
    return dict(sorted(runs.items()))


def _size(path: Path) -> int:
    """Size of a log, bytes; 0 if another run has removed it in the meantime."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _removable(runs: list[list[Path]]) -> Iterator[Path]:
    """Yield the logs that may be removed, in order; a run's own log and its plant's log stay together."""
    old = [logs for logs in runs[:-1] if not any(map(being_written, logs))]
    for logs in sorted(old, key=lambda logs: any(map(_had_trouble, logs))):
        yield from logs


def _had_trouble(path: Path) -> bool:
    """True for a log with a fault, a truncated or an unreadable log: somebody may still need it."""
    if path.stem.endswith("-plant"):
        return False
    try:
        log = Log(path)
    except HilError:
        return True
    end = log.metadata.get(SUMMARY, {})
    return bool(log.cut) or end.get("faults") != "0"
