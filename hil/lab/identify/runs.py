"""Common start of all `hil identify` commands: a run with an excitation, or an existing log of a run."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Flags, Rows
from drivers.errors import ConfigurationError, LogError
from drivers.files import open_regular
from drivers.signals import DriveState
from hil.app.check.command import refuse_unreachable
from hil.app.configuration.changes import unattended, with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.platform import build_platform
from hil.app.replay import law_of_log, open_run
from hil.app.run.command import run_daemon
from hil.app.sim.command import simulate
from hil.config.model import ModelSettings
from hil.config.reference import Evaluated, HoldReference
from hil.config.values import Pose
from hil.control.model import build_model
from hil.record.mcap_file import MAGIC
from hil.robot.dynamics import Model

FORCE_SHARE = 0.02
"""Default excitation force, as a share of limits.force_N;"""
STEP_SHARE = 0.1
"""and its largest share of limits.force_step_N and limits.force_window_N."""


SAME_S = 1e-7
"""Two ticks whose samples are closer than this show the same sample."""


class Recorded(NamedTuple):
    """Log of a run: its configuration, tick rows, rate and attached files."""

    configuration: Configuration
    rows: Rows
    rate_Hz: float
    attachments: dict[str, bytes]


class Episode(NamedTuple):
    """Part of a log with a row for each of its n ticks: a missing tick repeats the row before."""

    rows: Rows
    p: Array
    """(n, 3) m, platform position, base frame."""
    R: Array
    """(n, 3, 3) rotation, platform to base."""
    good: Flags
    """(n,): recorded, all legs fresh, with pose and twist."""


def is_log(source: Path) -> bool:
    """True if a file is a log (MCAP) rather than a configuration."""
    try:
        with open_regular(source) as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def refuse_fused(c: Configuration, where: object, task: str = "identify") -> None:
    """Raise ConfigurationError for a fused pose, whose motion is biased by the model; task: user's goal."""
    if c.estimation.pose == "fused":
        raise ConfigurationError(
            f"{where}: estimation.pose: fused: the log holds the filter's motion, biased to the masses and "
            f"forces of the controller's model; allowed: legs, in a run to {task} from"
        )


def excitation_force(c: Configuration, force_N: float | None) -> float:
    """Largest leg force of an excitation, N. Raises ConfigurationError if limits would cut it."""
    most = STEP_SHARE * min(c.limits.force_step_N, c.limits.force_window_N)
    force = min(FORCE_SHARE * c.limits.force_N, most) if force_N is None else force_N
    if force > 5 * most:
        raise ConfigurationError(
            f"--force {force:g}: allowed: up to {5 * most:g}, half of limits.force_step_N and force_window_N"
        )
    return force


def excitation_pose(c: Configuration) -> Pose:
    """Pose about which the excitation moves: that of a `hold` reference, else home."""
    held = c.reference.pose if isinstance(c.reference, HoldReference) else None
    return held or c.platform.home


def excited_by(c: Configuration, reference: Evaluated) -> Configuration:
    """The configuration with the given reference. Raises ConfigurationError if that is out of reach."""
    changes = {"name": f"{c.name[:80]}-identify", "reference": reference.model_dump(mode="json")}
    made = loads(with_changes(c.text, changes | {"feedforward": None}), c.source, c.folder)
    refuse_unreachable(made)
    return made


def exact_model(c: Configuration) -> Model:
    """Full dynamic model of the robot, with the friction and inertia configured for the law, if any."""
    believed = c.controller.believed or ModelSettings()
    full = believed.model_copy(update={"variant": "full", "frozen_at": None})
    return build_model(full, build_platform(c.platform), c.platform.leg_spin)


def run_for(
    c: Configuration, log: Path | None, *, real_time: bool, with_plant: bool, arm: bool
) -> dict[str, Any]:
    """Simulate, or run in real time if `real_time`; return the summary. Raises ConfigurationError."""
    if real_time:
        return run_daemon(c, log=log, with_plant=with_plant, draw=False, arm=arm)
    if c.plant is None:
        raise ConfigurationError(f"{c.source}: no section plant to simulate; --run moves real drives")
    return simulate(unattended(c), log=log)


def recorded_run(path: Path) -> Recorded:
    """Read a log of `hil run` or `hil sim`. Raises LogError for any other file."""
    log, run, configuration = open_run(path)
    configuration = law_of_log(configuration, log, run, trust_code=False)
    return Recorded(configuration, log.rows(), float(run["rate_Hz"]), log.attachments)


def episode(rows: Rows) -> Episode:
    """All ticks from the first to the last of `rows`, with gaps filled; `rows` must not be empty."""
    ticks = np.arange(rows["tick"][0], rows["tick"][-1] + 1)
    source = np.searchsorted(rows["tick"], ticks, side="right") - 1
    there = rows["tick"][source] == ticks
    rows = rows[source]
    fresh = (rows["age"] == 0).all(axis=1)
    known = np.isfinite(rows["p"]).all(axis=1) & np.isfinite(rows["twist"]).all(axis=1)
    p, R = np.ascontiguousarray(rows["p"]), np.ascontiguousarray(rows["R"]).reshape(-1, 3, 3)
    return Episode(rows, p, R, np.asarray(there & fresh & known))


def at_ticks(rows: Rows, column: str, period_s: float) -> Array:
    """Values (n, 6) of a sensor on each leg at the instants of the ticks, linear between its samples.

    NaN before the first and after the last sample. `rows` without gaps.
    """
    t = np.arange(len(rows)) * period_s
    found = np.full((len(rows), 6), np.nan)
    for leg in range(6):
        taken = np.fmax(t - rows[f"{column}_age"][:, leg], -1.0)
        new = np.diff(taken, prepend=-1.0) > SAME_S
        if new.any():
            values = rows[column][new, leg]
            found[:, leg] = np.interp(t, taken[new], values, left=np.nan, right=np.nan)
    return found


def brakes_open(rows: Rows) -> Flags:
    """Mask (n,) of rows with all brakes open. Raises LogError if there is no such row."""
    running = np.asarray((rows["drive_state"] == DriveState.RUN).all(axis=1))
    if not running.any():
        raise LogError("the brakes were never open in this log: nothing moved")
    return running
