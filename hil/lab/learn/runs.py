"""Reads a log as a learning trial: complete, undisturbed, with the reference at full speed."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.errors import LogError
from drivers.signals import Fault, Mode, Warn
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.feedforward_file import made_for, read_feedforward
from hil.app.recorded_files import FEEDFORWARD_CSV, attached
from hil.config.feedforward import FeedforwardHead, MadeFor
from hil.lab.identify.linearised import linearised_law
from hil.lab.identify.runs import recorded_run, refuse_fused
from hil.lab.learn.model import decay_rate, force_per_acceleration
from hil.lab.learn.trial import LEAD_S, Trial, trial
from hil.trajectory.build import build_trajectory

LIMITED = Warn.FORCE_LIMIT | Warn.FORCE_STEP | Warn.FORCE_WINDOW
MOST_S = 400.0
"""Longest reference, since a run must read the file of its feed-forward."""
FEWEST_S = 0.2
APART = 1e-6
"""Largest deviation of the reference's time from its tick, as a share of the period."""


class LearningRun(NamedTuple):
    """A run that learning can use, with its errors and the feed-forward that acted."""

    path: Path
    configuration: Configuration
    """As in the log; files that it names may no longer exist."""
    trial: Trial
    force_per_acceleration: Array
    """(lead + count, 6, 6) N s^2/m, of the law's own model along the reference."""
    tau_learned: Array
    """(lead + count, 6) N, learned force that acted."""
    made_for: MadeFor
    head: FeedforwardHead | None
    """Head of the feed-forward that acted; None without one."""

    @property
    def number(self) -> int:
        """Number of runs that this run's feed-forward was learned from."""
        return 0 if self.head is None else self.head.run


def learning_run(path: Path) -> LearningRun:
    """Read the log of a run for learning.

    Raises LogError: not a log of a run, or an unusable one: a fault, missing ticks, a hold, a stop or another
    speed than the clock's, forces cut by a limit. ConfigurationError: a law of another kind, a fused pose.
    """
    recorded = recorded_run(path)
    refuse_fused(recorded.configuration, path, "learn")
    with attached(recorded.configuration, recorded.attachments) as c:
        prints = made_for(c.reference, c.controller, c.platform, c.folder)
        law = linearised_law(c)
        trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
        wn = decay_rate(c)
    head = None
    if c.feedforward is not None:
        head = read_feedforward(recorded.attachments[FEEDFORWARD_CSV], f"{path}:{FEEDFORWARD_CSV}")[0]
    duration, rows, period_s = trajectory.duration_s, recorded.rows, 1.0 / recorded.rate_Hz
    if duration is None or not FEWEST_S <= duration <= MOST_S:
        raise LogError(
            f"{path}: its reference lasts {duration or 'for ever'} s, allowed: {FEWEST_S:g} to {MOST_S:g} s"
        )
    if recorded.rate_Hz != c.loop.rate_Hz:
        raise LogError(
            f"{path}: ran at {recorded.rate_Hz:g} Hz, allowed: loop.rate_Hz, {c.loop.rate_Hz:g} Hz"
        )
    count = int(duration / period_s + 0.5)
    lead, along = _whole(path, rows, period_s, count)
    A = force_per_acceleration(law.model, _of(along["p_d"]), _of(along["R_d"]).reshape(-1, 3, 3))
    tau = _of(along["tau_learned"])
    a = _of(np.linalg.solve(A, tau[:, :, None])[:, :, 0])
    e, de = _of(along["q_d"] - along["q"]), _of(along["dq_d"] - along["dq"])
    run = trial(period_s, lead, e, de, a, wn)
    return LearningRun(path, recorded.configuration, run, A, tau, prints, head)


def _of(column: Any) -> Array:
    return np.ascontiguousarray(column, np.float64)


def _whole(path: Path, rows: Rows, period_s: float, count: int) -> tuple[int, Rows]:
    """Number of rows before the reference, and these with the reference's `count`. Raises LogError."""
    tracking = rows[rows["mode"] == Mode.TRACKING]
    faults = int(np.bitwise_or.reduce(rows["faults"])) if len(rows) else 0
    if faults:
        names = ", ".join(str(f.name) for f in Fault if faults & f)
        raise LogError(f"{path}: the run ended in a fault ({names}), allowed: a run without fault")
    along = tracking[:count]
    t, ticks = along["reference_time_s"], along["tick"]
    if len(along) < count or ticks[-1] - ticks[0] != count - 1:
        raise LogError(
            f"{path}: {len(along)} of {count} ticks along the reference are recorded, allowed: all"
        )
    off = np.abs(t / period_s - np.arange(count)) > APART
    if off.any():
        first = int(off.argmax())
        raise LogError(
            f"{path}: from {first * period_s:.3f} s after its start the reference's time differs from the "
            "clock's because of a hold, a stop or another speed; allowed: a run at full speed"
        )
    most = round(LEAD_S / period_s)
    before = ticks[0] - rows["tick"]
    approach = rows[(rows["mode"] == Mode.APPROACH) & (before > 0) & (before <= most)]
    if len(approach) and ticks[0] - approach["tick"][0] != len(approach):
        approach = approach[:0]
    teaching = np.concatenate([approach, along])
    cut = (teaching["warnings"] & int(LIMITED)) != 0
    if cut.any():
        since_s = (int(cut.argmax()) - len(approach)) * period_s
        raise LogError(
            f"{path}: limits cut the forces at {int(cut.sum())} ticks, from {since_s:+.3f} s on, and a cut "
            "force cannot be learned. Raise limits.force_N, force_step_N or force_window_N, slow "
            "the reference down, or, where legs at rest were pushed, state monitor.friction_N"
        )
    return len(approach), teaching
