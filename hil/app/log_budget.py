"""Old logs make room for a new one: `recording.budget_GB`.

Only logs with dated names of the same configuration in its recordings folder count and go; a log that was
given a name of its own is never touched.
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
"""What a tick takes in a log at most: 0.8 to 1.1 kB were measured on the shipped configurations."""
GB = 1_000_000_000


def needed_bytes(c: Configuration, path_s: float | None, duration_s: float | None) -> int:
    """Return what a run may write at most, bytes; 0 where it has no end that is known.

    path_s: duration of the reference. Approach, brake tests and parking count as half a minute.
    """
    ends = [s for s in (path_s, duration_s) if s is not None]
    return round((min(ends) + 30.0) * c.loop.rate_Hz * TICK_BYTES) if ends else 0


def make_room(c: Configuration, needed: int, given: Path | None = None) -> list[str]:
    """Remove old logs until the budget and the disk have room for `needed` bytes; return what was removed.

    The oldest go first: those that ended without a fault, then the others. The newest stays, and so does each
    run that is being recorded meanwhile. Without `recording.budget_GB` nothing is removed. The folder has to
    be there. Raises LogError: the disk has less than the run may need, or the budget is smaller than that.
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
        for path in _going(list(runs.values())):
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
    """Return the logs of the runs of a configuration that got their names from them, the oldest run first.

    A run is its date and its number on it; it has its own log, its plant's, or both.
    """
    pattern = re.compile(re.escape(name) + r"-(\d{8}T\d{6})(?:-(\d+))?(?:-plant)?\.mcap")
    runs: dict[tuple[str, int], list[Path]] = {}
    for path in sorted(folder.glob("*.mcap"), key=lambda path: path.stem):
        if found := pattern.fullmatch(path.name):
            runs.setdefault((found[1], int(found[2] or 1)), []).append(path)
    return dict(sorted(runs.items()))


def _size(path: Path) -> int:
    """Return the bytes of a log; 0 of one that is gone: another run may have made room meanwhile."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _going(runs: list[list[Path]]) -> Iterator[Path]:
    """Yield what may go, in its order: a run's own log and its plant's go and stay together."""
    old = [logs for logs in runs[:-1] if not any(map(being_written, logs))]
    for logs in sorted(old, key=lambda logs: any(map(_had_trouble, logs))):
        yield from logs


def _had_trouble(path: Path) -> bool:
    """Tell whether a log holds a fault, was cut, or cannot be read: what somebody may still want to see."""
    if path.stem.endswith("-plant"):
        return False
    try:
        log = Log(path)
    except HilError:
        return True
    end = log.metadata.get(SUMMARY, {})
    return bool(log.cut) or end.get("faults") != "0"
