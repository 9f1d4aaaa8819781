"""`hil.sim`: simulates a configuration from Python, with changes to its keys."""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import ConfigurationError
from hil.app.check.command import refuse_unreachable
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.fault_words import with_faults
from hil.app.sim.command import simulate
from hil.app.sim.commands import LATEST_S
from hil.record.log import Log


@dataclass(frozen=True)
class Run:
    """A simulation that has ended: its log and its summary."""

    log: Log
    """The log of the run."""
    summary: dict[str, Any]
    """Summary as `hil sim --json` writes it; keys carry their units."""

    def __repr__(self) -> str:
        return f"Run(success={self.success}, log={str(self.log.path)!r})"

    @property
    def success(self) -> bool:
        """True if the run parked without a fault and, if requested, the log replayed exactly."""
        return bool(self.summary["success"])


def sim(
    config: str | os.PathLike[str] = "virtual",
    *,
    duration_s: float | None = None,
    log: str | os.PathLike[str] | None = None,
    plant_log: bool = True,
    faults: str | Iterable[str] = (),
    setpoints: str | os.PathLike[str] | None = None,
    commands: Iterable[tuple[float, str]] = (),
    check_replay: bool = True,
    **changes: Any,
) -> Run:
    """Simulate a configuration in lockstep, both ends of the bus in simulated time, as `hil sim` does.

    Parameters
    ----------
    config
        A YAML file, or the name of a shipped configuration.
    duration_s
        Simulated seconds along the reference, after which the platform parks; None: to its end.
    log
        The log file to write; None: a new one in the folder `recording.folder`.
    plant_log
        Record the plant's true state in a second log, for ``run.log.frame("plant.p")``.
    faults
        Faults of the plant, in the words of ``hil sim --fault``: one text a fault.
    setpoints
        CSV of poses for a live reference.
    commands
        Operator commands ``[(2.5, "hold"), (4.0, "speed 40"), (4.0, "start")]``: simulated seconds since the
        first tick, and the words of ``hil ctl``. With an ``"arm"`` among them the run waits for it.
    check_replay
        Replay the log at the end, and count a difference as a failure.
    changes
        Sections of the configuration: ``controller={"wn_rad_s": 25}`` changes this key, a mapping with
        another `law` or `type` replaces the section, None removes a key.

    Returns
    -------
    Run
        Its log and its summary; `success` is False for a run that ended in a fault.

    Raises
    ------
    ConfigurationError
        Invalid configuration, change or duration, or a reference out of reach.
    PlantError
        The plant does not start.
    LogError
        The log exists, or cannot be written.
    """
    if duration_s is not None and not 0.0 < duration_s <= LATEST_S:
        raise ConfigurationError(
            f"duration_s {duration_s}: allowed: seconds > 0, up to {LATEST_S:g}, None: to the end"
        )
    configuration = load(Path(config))
    if changes:
        text = with_changes(configuration.text, {"name": configuration.name} | changes)
        configuration = loads(text, f"{configuration.source} with changes", configuration.folder)
    configuration.require("sim")
    refuse_unreachable(configuration)
    summary = simulate(
        with_faults(configuration, (faults,) if isinstance(faults, str) else faults),
        log=None if log is None else Path(log),
        duration_s=duration_s,
        check_replay=check_replay,
        setpoints=None if setpoints is None else Path(setpoints),
        commands=list(commands),
        plant_log=plant_log,
    )
    return Run(Log(summary["log"]), summary)
