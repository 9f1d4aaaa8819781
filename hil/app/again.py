"""`hil run --plant` on a machine that stalls: the run once more, at a rate that outlasts it."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

from drivers.errors import HilError
from hil.app.configuration import Configuration
from hil.app.output import console
from hil.app.run import run_daemon

_ENDS = (".mcap", "-plant.mcap", ".png")
"""What a run's files add to its name."""


def run_with_plant(
    configuration: Configuration,
    *,
    log: Path | None = None,
    duration_s: float | None = None,
    reset: bool = False,
) -> dict[str, Any]:
    """Run with the plant; where a stall of this machine ended the run, once more at the rate that it holds.

    Returns the summary of the run that counts; with key `stalled_run`, what the summary of the stalled one
    said (trouble, rate_Hz, ticks) and where its log is kept. The log that was asked for is the second one's.
    A configuration that cannot run slower leaves it at the first run. Raises as `hil.app.run.run_daemon`.
    """
    first = run_daemon(configuration, log=log, duration_s=duration_s, with_plant=True, reset=reset)
    if not first["stalled"]:
        return first
    path = Path(first["log"])
    kept = _set_aside(path)
    console.print(f"hil: {first['trouble']}; its log is {kept}", style="bold yellow", soft_wrap=True)
    reason = f"this machine stalls at {first['rate_Hz']:g} Hz, once more from the start"
    try:
        second = run_daemon(
            configuration, log=path, duration_s=duration_s, with_plant=True, reset=reset, slow=reason
        )
    except HilError as error:
        if path.exists():
            raise
        _move(kept, path)
        console.print(
            f"hil: not once more, the log is {path} again: {error}", style="bold yellow", soft_wrap=True
        )
        return first
    said = {key: first.get(key) for key in ("trouble", "rate_Hz", "ticks")}
    return second | {"stalled_run": said | {"log": str(kept)}}


def _set_aside(log: Path) -> Path:
    """Rename a run's files, NAME to NAME-stalled, and return the log's new path; nothing is overwritten."""
    kept, number = log.with_name(f"{log.stem}-stalled.mcap"), 2
    while any(os.path.lexists(kept.with_name(kept.stem + end)) for end in _ENDS):
        kept, number = log.with_name(f"{log.stem}-stalled-{number}.mcap"), number + 1
    _move(log, kept)
    return kept


def _move(log: Path, to: Path) -> None:
    for end in _ENDS:
        with contextlib.suppress(FileNotFoundError):
            log.with_name(log.stem + end).rename(to.with_name(to.stem + end))
