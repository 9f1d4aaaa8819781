"""Simulates one law on one configuration: along the reference, and with a set-point step at home.

Errors of a law become results; they are not raised.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.errors import HilError
from drivers.signals import Fault, Mode
from drivers.tick_columns import ROW
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.compare import DisturbanceSettings, StepSettings
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import pose_arrays
from hil.app.sim.build import build_lockstep
from hil.config.values import AXES
from hil.loop.clock import collector_paused
from hil.loop.run_end import Course
from hil.mathematics.rotations import rotation_from_vector
from hil.record.figures import limited_ticks
from hil.record.metrics import bandwidth_Hz, peak, rotation_errors, step_response
from hil.study.campaign.figures import Measurement
from hil.trajectory.path import PoseSample, Trajectory
from plant_fmu.faults.kinds import WrenchStep
from plant_fmu.faults.plan import FaultPlan

SETTLE_PERIODS = 30.0
"""Settling time around a step, in time constants 1 / wn: exp(-30) is negligible; an integral is slower."""


class Job(NamedTuple):
    """Everything that a separate process needs for one measurement."""

    law: str
    path: str
    configuration: Configuration
    duration_s: float
    """Time along the reference."""
    disturbance: DisturbanceSettings | None
    step: StepSettings | None
    """Set-point step at home; None: no step on this path."""
    settle_s: float


class Outcome(NamedTuple):
    """Measurements of one law on one path, or the fault that ended it."""

    law: str
    path: str
    fault: str | None
    """Names of the latched faults, or why the job could not run; None: no fault."""
    fault_s: float | None
    """Time of the fault along the reference; None: no fault, or a fault before tracking."""
    figures: dict[str, Any]
    """Metrics by name; empty: nothing was measured."""
    traces: dict[str, Array]
    """Curves of the picture: t, error_mm, force_N, step_t, step."""


@dataclass(frozen=True)
class StepTrajectory:
    """Reference that jumps from pose (p0, R0) to (p1, R1) at `at_s`, with all rates zero: no feed-forward."""

    p0: Array
    R0: Array
    p1: Array
    R1: Array
    at_s: float
    duration_s: float | None

    def sample(self, t: float) -> PoseSample:
        """Pose at time t, s, with zero twist and acceleration."""
        still = np.zeros(6)
        p, R = (self.p0, self.R0) if t < self.at_s else (self.p1, self.R1)
        return PoseSample(p, R, still, still)


def measure(job: Job) -> Outcome:
    """Simulate one law on one path. A fault, or an error of law or plant, becomes part of the outcome."""
    try:
        with collector_paused(), np.errstate(all="ignore"):  # a diverging law ends in its fault
            return _measure(job)
    except (HilError, ArithmeticError, np.linalg.LinAlgError) as error:
        return Outcome(job.law, job.path, str(error) or type(error).__name__, None, {}, {})


def _measure(job: Job) -> Outcome:
    c = job.configuration
    rows, lengths = _run(c, job.duration_s, load=job.disturbance)
    fault, on_path = _fault(rows), rows["mode"] == Mode.TRACKING
    tracked = rows[on_path]
    figures = _tracking(tracked, lengths[on_path]) if len(tracked) else {}
    figures["limited_ticks"] = limited_ticks(tracked)
    traces: dict[str, Array] = {
        "t": tracked["reference_time_s"],
        "error_mm": np.abs(_errors_mm(tracked)).max(axis=1),
        "force_N": np.abs(tracked["tau"]).max(axis=1),
    }
    fault_s = float(tracked["reference_time_s"][-1]) if fault and len(tracked) else None
    if job.step is not None:
        at_rest, step_traces, step_fault = _at_rest(job, c, job.step)
        figures |= at_rest
        traces |= step_traces
        if fault is None and step_fault is not None:
            fault = f"{step_fault} at the step"
    return Outcome(job.law, job.path, fault, fault_s, figures, traces)


def _run(
    c: Configuration,
    duration_s: float,
    *,
    trajectory: Trajectory | None = None,
    load: DisturbanceSettings | None = None,
) -> tuple[Rows, Array]:
    """Tick rows (n,) until `duration_s` of tracking, the path's end, or a fault; true lengths (n, 6) m."""
    rate = c.loop.rate_Hz
    cycle = build_cycle(c, rate, c.drives.watchdog_ms * 1e-3, trajectory=trajectory)
    nodes, physics = build_nodes(c, None if load is None else FaultPlan([_wrench(load)]))
    rows: list[Rows] = []
    lengths: list[Array] = []
    begun: int | None = None
    ticks = math.floor(duration_s * rate + 1e-6)
    course = Course(cycle)
    try:
        lockstep = build_lockstep(c, cycle, nodes)
        while True:
            rows.append(lockstep.step(course.commands(lockstep.tick + 1))[2].row)
            lengths.append(nodes.snapshot().length)
            mode = cycle.mode
            if mode is Mode.TRACKING and begun is None:
                begun = lockstep.tick
            over = rows[-1]["faults"] or course.ending(lockstep.tick)
            if over or (begun is not None and (mode is not Mode.TRACKING or lockstep.tick - begun >= ticks)):
                return np.array(rows, ROW), np.array(lengths)
    finally:
        physics.close()


def _wrench(d: DisturbanceSettings) -> WrenchStep:
    lasts = None if d.stop_s is None else d.stop_s - d.start_s
    return WrenchStep(
        mode="TRACKING", at_s=d.start_s, for_s=lasts, force_N=d.force_N, moment_N_m=d.moment_N_m
    )


def _fault(rows: Rows) -> str | None:
    faults, mode = int(rows["faults"][-1]), Mode(int(rows["mode"][-1]))
    if faults:
        return " ".join(str(f.name) for f in Fault if faults & f)
    return None if (rows["mode"] == Mode.TRACKING).any() else f"did not start: {mode.name}"


def _tracking(rows: Rows, lengths: Array) -> dict[str, Any]:
    measured = Measurement(travels=False)
    for row, length in zip(rows, lengths, strict=True):
        measured.take(row, length)
    return {name: value for name, value in measured.figures().items() if value is not None}


def _at_rest(
    job: Job, c: Configuration, step: StepSettings
) -> tuple[dict[str, Any], dict[str, Array], str | None]:
    """Figures, curves and fault of a simulation at home: at rest, after a step, under the load."""
    rate, d = c.loop.rate_Hz, job.disturbance
    n = max(20, round(job.settle_s * rate))
    p, R = pose_arrays(c.platform.home)
    axis = AXES.index(step.axis)
    turns, word = divmod(axis, 3)
    size = float(np.deg2rad(step.size)) if turns else step.size
    shift = size * np.eye(3)[word]
    p1, R1 = (p, rotation_from_vector(shift) @ R) if turns else (p + shift, R)
    stretches = 2 if d is None else 3
    # Half a tick early: the sum of periods may fall short of the instant by its rounding.
    trajectory = StepTrajectory(p, R, p1, R1, (n - 0.5) / rate, (stretches + 1) * n / rate)
    stays = None if d is None else d.model_copy(update={"start_s": (2 * n - 0.5) / rate, "stop_s": None})
    rows, _ = _run(c, stretches * n / rate, trajectory=trajectory, load=stays)
    fault, rows = _fault(rows), rows[rows["mode"] == Mode.TRACKING]
    before, after, loaded = rows[:n], rows[n : 2 * n], rows[2 * n :]
    figures: dict[str, Any] = {}
    if len(before) == n:
        figures["steady_leg_error_mm"] = _steady_mm(before)
    if len(after) < n:
        return figures, {}, fault
    y0, y = (_moved(part, p, R)[:, axis] for part in (before, after))
    initial, t = float(_last_tenth(y0).mean()), np.arange(n) / rate
    answer = step_response(t, y, initial)
    figures |= {
        "rise_ms": 1e3 * answer.rise_s,
        "overshoot_percent": 100.0 * answer.overshoot,
        "settled": answer.settled,
        "bandwidth_Hz": bandwidth_Hz(t, y, initial),
    }
    if d is not None and len(loaded):
        figures["disturbed_peak_leg_error_mm"] = float(peak(_errors_mm(loaded)).max())
        if not fault:  # a fault ends the run before the platform is at rest under the load
            figures["disturbed_steady_leg_error_mm"] = _steady_mm(loaded)
    return figures, {"step_t": t, "step": (y - initial) / size}, fault


def _moved(rows: Rows, p: Array, R: Array) -> Array:
    """Displacement (n, 6), m and rad, of the measured pose from (p, R), base frame."""
    turned = rotation_errors(rows["R"], np.broadcast_to(R.ravel(), (len(rows), 9)))
    return np.hstack([rows["p"] - p, turned])


def _last_tenth(samples: Array) -> Array:
    return samples[-max(1, len(samples) // 10) :]


def _errors_mm(rows: Rows) -> Array:
    e: Array = 1e3 * (rows["q_d"] - rows["q"])
    return e


def _steady_mm(rows: Rows) -> float:
    """Largest mean error of a leg over the last tenth of the rows, mm."""
    return float(np.abs(_last_tenth(_errors_mm(rows)).mean(axis=0)).max())
