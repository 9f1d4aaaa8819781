"""Runs one row of a campaign in simulated time: its configuration, run and metrics. Reads no clock."""

import copy
import re
from typing import Any, NamedTuple

import numpy as np

from drivers.errors import ConfigurationError, HilError, PlantError
from drivers.signals import Fault, Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.changes import merged, text_of, unattended_data
from hil.app.configuration.configuration import Configuration, loads
from hil.app.sim.build import build_lockstep
from hil.loop.clock import collector_paused
from hil.loop.run_end import Course
from hil.signals import Operator
from hil.study.campaign.figures import METRICS, Measurement
from hil.study.campaign.keys import SEED, apply, at
from hil.study.campaign.named_files import Folders, find_beside, refuse_changed
from hil.study.campaign.settings import CampaignSettings
from plant_fmu.faults.plan import FaultPlan

LONGEST_S = 3600.0
"""Simulated time, s, after the reference; a run that has not ended by then has failed."""
_SENSORS_SEED = ("plant", "sensors", "seed")


class Subject(NamedTuple):
    """Data shared by all rows of a campaign."""

    base: dict[str, Any]
    """Configuration with the campaign's changes, plain data."""
    source: str
    folders: Folders
    settings: CampaignSettings
    files: dict[str, str] = {}
    """Digest, by path, of each file that a row may name."""


class Job(NamedTuple):
    """Everything that a separate process needs to run a row of a campaign."""

    subject: Subject
    number: int
    values: dict[str, Any]
    seed: int


class Ended(NamedTuple):
    """How and when the simulated run of a row ended."""

    how: str
    """complete, fault, limit, stopped or plant."""
    why: str
    faults: Fault
    """Latched faults."""
    ticks: int
    stop_tick: int | None = None
    """Tick of the command to stop and park."""


def row_configuration(job: Job) -> Configuration:
    """Configuration of a row, with its complete YAML text. Raises ConfigurationError if it is invalid."""
    subject = job.subject
    value = apply(copy.deepcopy(subject.base), subject.settings.axes, job.values)
    own = at(value, _SENSORS_SEED)
    if "sensors" in value and job.seed and (own is None or type(own) is int):
        seed = job.seed + (1 if own is None else own)
        value = merged(value, {"plant": {"sensors": {"seed": seed}}})
    value = unattended_data(value)
    find_beside(value, subject.folders)
    name = f"{subject.source} with the changes of row {job.number}"
    c = loads(text_of(value), name, subject.folders[0])
    c.require("sim")
    return c


def run_row(job: Job) -> dict[str, Any]:
    """Run a row; return `passed`, `ended`, `ended_s`, `faults`, `trouble` and METRICS as plain values.

    Errors of the row are part of the outcome. Raises MemoryError, OSError: trouble of the machine, the row
    may run later; ConfigurationError: a file that rows read has changed.
    """
    return performed(job)[0]


def performed(job: Job) -> tuple[dict[str, Any], Ended | None]:
    """Run a row; return its outcome and the end of its run (None: no run). Raises like `run_row`."""
    ended = None
    try:
        c = row_configuration(job)
        with collector_paused(), np.errstate(all="ignore"):  # a diverging law ends in its fault
            measured = Measurement(travels=job.subject.settings.after_fault == "rest")
            ended = run(c, job, measured)
        found = outcome(job, c.loop.rate_Hz, ended, measured)
    except (MemoryError, OSError):
        raise
    except ConfigurationError as error:
        found = not_run(job, "refused", "\n".join(map(bare, error.problems)))
    except Exception as error:  # noqa: BLE001 - any error of a diverging law fails only its row
        kind = "" if isinstance(error, HilError) else f"{type(error).__name__}: "
        found = not_run(job, "error", f"{kind}{error}")
    refuse_changed(job.subject.files)
    for folder in sorted(map(str, job.subject.folders), key=len, reverse=True):
        found["trouble"] = found["trouble"].replace(f"{folder}/", "")  # the same text wherever the files are
    return found, ended


def bare(problem: str) -> str:
    """Error message without its position in the merged configuration, which no user has seen."""
    return re.sub(r"^.* with the changes of (the campaign|row [0-9]+):([0-9]+:[0-9]+:)? ?", "", problem)


def not_run(job: Job, how: str = "died", why: str = "its process died, twice") -> dict[str, Any]:
    """Outcome of a row that has no run; how: value of column `ended`; why: the reason."""
    end = {"passed": False, "ended": how, "ended_s": None, "faults": "", "trouble": why}
    return {"row": job.number, "seed": job.seed, **job.values, **end, **dict.fromkeys(METRICS)}


def outcome(job: Job, rate_Hz: float, ended: Ended, measured: Measurement) -> dict[str, Any]:
    """Outcome of a row's run, as in the table. A limit on an unmeasured metric counts as exceeded."""
    figures = measured.figures()
    kept = not any(limit.passed_by(figures.get(name)) for name, limit in job.subject.settings.kept.items())
    return not_run(job) | {
        "passed": ended.how in ("complete", "fault") and kept,
        "ended": ended.how,
        "ended_s": ended.ticks / rate_Hz,
        "faults": " ".join(str(fault.name) for fault in Fault if fault and fault in ended.faults),
        "trouble": ended.why,
        **figures,
    }


def run(c: Configuration, job: Job, measured: Measurement) -> Ended:
    """Simulate controller and plant in lockstep until the row's end.

    Raises ConfigurationError: invalid configuration, or neither reference nor campaign has an end;
    PlantError: the plant does not start.
    """
    settings, rate = job.subject.settings, c.loop.rate_Hz
    cycle = build_cycle(c, rate, c.drives.watchdog_ms * 1e-3)
    tracked_s = settings.duration_s or cycle.parts.trajectory.duration_s
    if tracked_s is None:
        raise ConfigurationError(f"{c.source}: reference: has no end: add duration_s to the campaign")
    nodes, physics = build_nodes(c, FaultPlan((), job.seed))
    ticks = None if settings.duration_s is None else int(settings.duration_s * rate + 1e-6)
    most = round((tracked_s + LONGEST_S) * rate)
    course, tick, faulted = Course(cycle), 0, False
    begun: int | None = None
    stop_tick: int | None = None

    def ended(how: str, why: str = "") -> Ended:
        return Ended(how, why, cycle.faults, tick + 1, stop_tick)

    try:
        lockstep = build_lockstep(c, cycle, nodes)
        while (tick := lockstep.tick + 1) < most:
            try:
                row = lockstep.step(course.commands(tick, (Operator.STOP,) * (tick == stop_tick)))[2].row
            except PlantError as error:
                return ended("plant", str(error))._replace(ticks=tick)
            full = measured.take(row, nodes.snapshot().length)
            mode, ending = cycle.mode, course.ending(tick)
            faulted = faulted or bool(cycle.faults)
            if faulted and (ending is not None or settings.after_fault == "end"):
                story = course.story()
                return ended("fault", "" if story is None else story.short)
            if ending is not None:
                parked = mode is Mode.PARKED and not ending.reason
                return ended("complete" if parked else "stopped", ending.reason)
            if full and not faulted and _limit_exceeded(settings, measured):
                return ended("limit")
            begun = tick if begun is None and mode is Mode.TRACKING else begun
            over = begun is not None and ticks is not None and tick - begun >= ticks
            if settings.until == "tracking" and begun is not None and (over or mode is not Mode.TRACKING):
                return ended("complete")
            if over and stop_tick is None:
                stop_tick = tick + 1
        why = f"the run has not ended {LONGEST_S:g} s after its {tracked_s:g} s of tracking"
        return ended("stopped", why)._replace(ticks=most)
    finally:
        physics.close()


def _limit_exceeded(settings: CampaignSettings, measured: Measurement) -> bool:
    """True if a peak or a count exceeds its limit; more ticks cannot undo that."""
    most = {name: limit.max for name, limit in settings.kept.items() if limit.max is not None}
    return any(value > most.get(name, value) for name, value in measured.growing().items())


def row_seed(settings: CampaignSettings, values: dict[str, Any], sample: int) -> int:
    """Random seed of a row: the value of key `seed`, else the number of its sample.

    Raises ConfigurationError: not an integer from 0 to 2**63 - 1, the range of the table's column.
    """
    named = [given for name, given in values.items() if SEED in settings.axes[name].targets]
    seed = named[-1] if named else sample
    if type(seed) is not int or not 0 <= seed < 2**63:
        raise ConfigurationError(f"{SEED}: allowed: integers from 0 to 2**63 - 1, given: {seed!r}")
    return seed
