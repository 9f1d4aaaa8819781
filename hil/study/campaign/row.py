"""One row of a campaign: its configuration, its run in lockstep, its figures; it reads files, no clock."""

import copy
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.errors import ConfigurationError, HilError, PlantError
from drivers.signals import Fault, Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.changes import text_of
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.unattended import unattended_data
from hil.app.sim.build import build_lockstep
from hil.loop.clock import collector_paused
from hil.loop.run_end import Course
from hil.signals import Operator
from hil.study.campaign.figures import METRICS, Measurement, broken
from hil.study.campaign.keys import SEED, apply, keys
from hil.study.campaign.named_files import find_beside, refuse_changed
from hil.study.campaign.settings import Limit, ListedAxis
from plant_fmu.faults.plan import FaultPlan

LONGEST_S = 3600.0
"""A run that has not ended so long after what it tracks would have, has failed, simulated s."""


class Subject(NamedTuple):
    """What all rows of a campaign share."""

    base: dict[str, Any]
    """The configuration with the campaign's changes, plain data."""
    source: str
    folder: Path
    """Of the configuration, absolute: base of relative paths in it."""
    campaign_folder: Path
    """Of the campaign file, absolute: where they are looked for next."""
    here: Path
    """Where the campaign was read, absolute: where the data sheet of a drive is looked for first."""
    axes: dict[str, ListedAxis]
    limits: dict[str, Limit]
    duration_s: float | None
    """Along the reference; None: to its end."""
    parks: bool
    rests: bool
    """Whether a run goes on after a fault until the platform rests."""
    files: dict[str, str] = {}
    """Digest of each file that a row may name, by its path."""


class Job(NamedTuple):
    """A row that is to be run, complete: what a process of its own needs to know."""

    subject: Subject
    number: int
    values: dict[str, Any]
    seed: int


class Ended(NamedTuple):
    """Why a row's run has ended, and in which ticks."""

    how: str
    """complete, fault, limit, stopped, plant."""
    why: str
    ticks: int
    stop_tick: int | None = None
    """At which it was told to park."""


def row_configuration(job: Job) -> Configuration:
    """Return the configuration of a row, its text whole. Raises ConfigurationError."""
    subject = job.subject
    value = apply(copy.deepcopy(subject.base), subject.axes, job.values)
    if "sensors" in value and job.seed:
        _vary_sensors(value, job.seed)
    value = unattended_data(value)
    find_beside(value, subject.folder, subject.campaign_folder, subject.here)
    name = f"{subject.source} with the changes of row {job.number}"
    c = loads(text_of(value), name, subject.folder)
    c.require("sim")
    return c


def _vary_sensors(value: dict[str, Any], seed: int) -> None:
    """Add to the seed of the sensors' noise, in data not looked at yet: what is wrong is told later."""
    plant = value.get("plant")
    emulated = plant.get("sensors", {}) if isinstance(plant, dict) else None
    own = emulated.get("seed", 1) if isinstance(emulated, dict) else None
    if isinstance(plant, dict) and isinstance(emulated, dict) and type(own) is int:
        value["plant"] = plant | {"sensors": emulated | {"seed": own + seed}}


class Ran(NamedTuple):
    """A row that was tried: its outcome, and how its run ended, None where it has not begun or not ended."""

    outcome: dict[str, Any]
    ended: Ended | None
    faults: Fault


def run_row(job: Job) -> dict[str, Any]:
    """Run a row; return `passed`, `ended`, `ended_s`, `faults`, `trouble` and METRICS as plain values.

    What goes wrong with it is in the outcome. Raises MemoryError, OSError: that is the machine's trouble, and
    the row may run later; ConfigurationError: a file that rows name is no more what it was.
    """
    return performed(job).outcome


def performed(job: Job) -> Ran:
    """Run a row. Raises as `run_row`."""
    refuse_changed(job.subject.files)
    ran = _performed(job)
    refuse_changed(job.subject.files)  # nor while it ran
    for folder in (
        job.subject.campaign_folder,
        job.subject.folder,
        job.subject.here,
    ):  # where they lie makes no difference
        ran.outcome["trouble"] = ran.outcome["trouble"].replace(f"{folder}/", "")
    return ran


def _performed(job: Job) -> Ran:
    try:
        c = row_configuration(job)
        with collector_paused(), np.errstate(all="ignore"):  # a law that diverges says so by its fault
            measured = Measurement(travels=job.subject.rests)
            ended, faults = run(c, job, measured)
    except (MemoryError, OSError):
        raise
    except ConfigurationError as error:
        return Ran(not_run(job, "refused", "\n".join(map(bare, error.problems))), None, Fault(0))
    except HilError as error:
        return Ran(not_run(job, "error", str(error)), None, Fault(0))
    except Exception as error:  # noqa: BLE001 - whatever a law raises that diverges ends its row and no other
        return Ran(not_run(job, "error", f"{type(error).__name__}: {error}"), None, Fault(0))
    return Ran(outcome(job, c.loop.rate_Hz, ended, faults, measured), ended, faults)


def bare(problem: str) -> str:
    """Return a problem of a text that was made here without its place there: nobody has that text."""
    return re.sub(r"^.* with the changes of (the campaign|row [0-9]+):([0-9]+:[0-9]+:)? ?", "", problem)


def not_run(job: Job, how: str = "died", why: str = "its process died, twice") -> dict[str, Any]:
    """Return the outcome of a row that has no run."""
    head = {"row": job.number, "passed": False, "ended": how, "ended_s": None, "faults": "", "trouble": why}
    return head | dict.fromkeys(METRICS)


def outcome(job: Job, rate_Hz: float, ended: Ended, faults: Fault, measured: Measurement) -> dict[str, Any]:
    """Return what a row's line in the table says of its run."""
    figures = measured.figures()
    return {
        "row": job.number,
        "passed": ended.how in ("complete", "fault") and not broken(job.subject.limits, figures),
        "ended": ended.how,
        "ended_s": ended.ticks / rate_Hz,
        "faults": " ".join(str(fault.name) for fault in Fault if fault and fault in faults),
        "trouble": ended.why,
        **figures,
    }


def run(c: Configuration, job: Job, measured: Measurement) -> tuple[Ended, Fault]:
    """Run both ends of the bus in lockstep until the row's end; return that and the latched faults.

    Raises ConfigurationError, PlantError: the plant does not start.
    """
    subject, rate = job.subject, c.loop.rate_Hz
    cycle = build_cycle(c, rate, c.drives.watchdog_ms * 1e-3)
    tracked_s = subject.duration_s or cycle.parts.trajectory.duration_s
    if tracked_s is None:
        raise ConfigurationError(f"{c.source}: reference: it has no end: give the campaign a duration_s")
    nodes, physics = build_nodes(c, FaultPlan((), job.seed))
    ticks = None if subject.duration_s is None else int(subject.duration_s * rate + 1e-6)
    course, begun, stop_tick, faulted = Course(cycle), None, None, False
    try:
        lockstep = build_lockstep(c, cycle, nodes)
        while lockstep.tick + 1 < round((tracked_s + LONGEST_S) * rate):
            tick = lockstep.tick + 1
            try:
                row = lockstep.step(course.commands(tick, (Operator.STOP,) * (tick == stop_tick)))[2].row
            except PlantError as error:
                return Ended("plant", str(error), tick, stop_tick), cycle.faults
            full = measured.take(row, nodes.snapshot().length)
            mode, ending = cycle.mode, course.ending(tick)
            faulted = faulted or bool(cycle.faults)
            if faulted and (ending is not None or not subject.rests):
                story = course.story()
                why = "" if story is None else story.short
                return Ended("fault", why, tick + 1, stop_tick), cycle.faults
            if ending is not None:
                how = "complete" if mode is Mode.PARKED and not ending.reason else "stopped"
                return Ended(how, ending.reason, tick + 1, stop_tick), cycle.faults
            if full and not faulted and measured.passed_limit(subject.limits):
                return Ended("limit", "", tick + 1, stop_tick), cycle.faults
            begun = tick if begun is None and mode is Mode.TRACKING else begun
            over = begun is not None and ticks is not None and tick - begun >= ticks
            if not subject.parks and begun is not None and (over or mode is not Mode.TRACKING):
                return Ended("complete", "", tick + 1, stop_tick), cycle.faults
            if over and stop_tick is None:
                stop_tick = tick + 1
        why = f"it has not ended {LONGEST_S:g} s after the {tracked_s:g} s that it tracks"
        return Ended("stopped", why, lockstep.tick + 1, stop_tick), cycle.faults
    finally:
        physics.close()


def row_seed(axes: dict[str, ListedAxis], values: dict[str, Any], sample: int) -> int:
    """Return what varies the chance of a row: the value of key `seed`, else the number of its sample."""
    named = [values[name] for name, axis in axes.items() if SEED in keys(axis)]
    return int(named[-1]) if named else sample
