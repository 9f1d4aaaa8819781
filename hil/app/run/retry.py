"""`hil run --plant` on a machine that stalls: one retry at a rate that survives the stall."""

import os
from pathlib import Path
from typing import Any

from drivers.errors import HilError
from hil.app.configuration.configuration import Configuration
from hil.app.output import warn
from hil.app.run.command import run_daemon


def run_with_plant(
    configuration: Configuration,
    *,
    log: Path | None = None,
    duration_s: float | None = None,
    reset: bool = False,
) -> dict[str, Any]:
    """Run with the plant; if this machine stalled, run once more at a rate that it holds.

    Returns the summary of the run that counts: the second, or the first where no second one began. After a
    retry, key `stalled_run` has trouble, rate_Hz, ticks and log of the first run, and `log` is the second's.
    Raises as `hil.app.run.command.run_daemon`.
    """
    first = run_daemon(configuration, log=log, duration_s=duration_s, with_plant=True, reset=reset)
    if not first["stalled"]:
        return first
    path = Path(first["log"])
    try:
        _set_aside(first)
    except OSError as error:
        warn(f"hil: the run is not repeated: {error}")
        return first
    warn(f"hil: {first['trouble']}; its log is {first['log']}")
    reason = f"this machine stalls at {first['rate_Hz']:g} Hz, retry from the start"
    try:
        second = run_daemon(
            configuration, log=path, duration_s=duration_s, with_plant=True, reset=reset, slow=reason
        )
    except HilError as error:
        warn(f"hil: the run is not repeated: {error}")
        return first
    return second | {"stalled_run": {key: first.get(key) for key in ("trouble", "rate_Hz", "ticks", "log")}}


def _set_aside(summary: dict[str, Any]) -> None:
    """Rename the files of a run, NAME to NAME-stalled, here and in its summary; nothing is overwritten."""
    holders = [(summary, "log"), (summary.get("plant", {}), "log"), (summary, "picture")]
    holders = [(holder, key) for holder, key in holders if holder.get(key)]
    stem = Path(summary["log"]).stem
    kept, number = f"{stem}-stalled", 2
    while any(os.path.lexists(_named(holder[key], stem, kept)) for holder, key in holders):
        kept, number = f"{stem}-stalled-{number}", number + 1
    for holder, key in holders:
        file = _named(holder[key], stem, kept)
        Path(holder[key]).rename(file)
        holder[key] = str(file)


def _named(file: str, stem: str, new: str) -> Path:
    """Return a file of a run with another stem for the run's own."""
    path = Path(file)
    return path.with_name(path.name.replace(stem, new, 1))
