"""One case of the matrix, in lockstep."""

import time
from typing import Any, NamedTuple

import numpy as np

from drivers import build_protocol
from drivers.arrays import Array
from drivers.errors import HilError, PlantError, RunError
from drivers.family import Family
from drivers.signals import LEGS, Doubt, Fault, Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.fault_words import show_fault
from hil.app.sim.build import build_lockstep
from hil.loop.clock import collector_paused
from hil.loop.cycle import Cycle
from hil.loop.modes import Durations
from hil.loop.report import NO_WATCHDOG
from hil.loop.run_end import Course, Ending
from hil.signals import Operator
from hil.study.faults.cases import Case
from hil.study.faults.expected import COMMANDS_LOST, STRANGERS
from hil.study.faults.verdict import REST_S, Bounds, Trace, judge, see
from plant_fmu.faults.plan import FaultPlan

LONGEST_S = 60.0
"""A case that has not ended is a failure after so long, and what its configuration asks for, s."""
HELD_S = 3.0
"""A platform that is held with force is watched for so long, s."""
NO_LATCH = "obey whoever commands: no stop of ours latches"
"""Of families whose `stop_latches` is False."""
_NAMED_IN = {
    Fault.BRAKE: "legs_moved",
    Fault.ENCODER: "legs_doubted",
    Fault.DRIVE: "legs_refused",
    Fault.DUPLICATE_NODE: "doubled",
    Fault.SET_UP: "altered",
}
"""Columns in which a fault names legs after the tick in which it struck, too."""


class Job(NamedTuple):
    """A case and what it is judged by."""

    case: Case
    bounds: Bounds


def run_case(job: Job) -> dict[str, Any]:
    """Run a case and return what came of it as plain values; key `success` is the verdict."""
    begun = time.perf_counter()
    try:
        with collector_paused():
            found = _judged(job)
    except HilError as error:
        found = failed(job, str(error))
    return found | {"wall_s": time.perf_counter() - begun}


def failed(job: Job, why: str = "its process died") -> dict[str, Any]:
    """Return the outcome of a case that could not be run."""
    return _head(job.case) | {"success": False, "verdict": f"could not be run: {why}"}


def _head(case: Case) -> dict[str, Any]:
    fault = case.fault
    return {"kind": str(fault.kind), "when": case.moment, "fault": show_fault(fault), "given": case.given}


def _judged(job: Job) -> dict[str, Any]:
    case = job.case
    trace, ending = _run(case)
    if trace is None:
        why = f"the fault did not begin: the run ended in {ending.mode.name}"
        return failed(job, f"{why}. {ending.reason}".rstrip(". "))
    kind, c = str(case.fault.kind), case.configuration
    seen = see(kind, trace)
    good, verdict = judge(kind, trace, seen, job.bounds)
    verdict += "" if good else _why_of_drives(kind, build_protocol(c.bus, c.drives))
    return _head(case) | {
        "success": good,
        "verdict": verdict,
        "ended": "plant failed" if trace.failed else ending.mode.name,
        "faults": [str(fault.name) for fault in Fault if fault and fault in ending.faults],
        "legs": [] if trace.failed else sorted(frozenset().union(*trace.causes.values())),
        "causes": {cause: sorted(legs) for cause, legs in trace.causes.items()},
        "reason": ending.reason,
        "after_ms": None if seen.declared is None else 1e3 * seen.declared / trace.rate_Hz,
        "error_mm": 1e3 * seen.error_m,
        "travel_mm": 1e3 * seen.travel_m,
        "motion_mm": 1e3 * max(seen.error_m, seen.travel_m),
        "last_mm": 1e3 * seen.last_m,
    }


def _why_of_drives(kind: str, protocol: Family) -> str:
    """Say what such drives cannot do that would have kept the motion within its bound; empty for nothing."""
    if kind in COMMANDS_LOST and not protocol.traits.has_watchdog:
        return f"; the drives {NO_WATCHDOG}"
    return f"; the drives {NO_LATCH}" if kind in STRANGERS and not protocol.traits.stop_latches else ""


def _causes(cycle: Cycle, ending: Ending, named: dict[str, int]) -> dict[str, frozenset[int]]:
    """Return the faults that a run has latched, ENCODER with its doubt, each with the legs named.

    named : of the columns of `_NAMED_IN`, the bits of all ticks.
    """
    findings = () if ending.story is None else ending.story.findings
    causes: dict[str, frozenset[int]] = {}
    for fault in Fault(ending.faults):
        ours = (each.leg for each in findings if each.fault == fault.name)
        told = frozenset(leg for leg in ours if leg is not None)
        doubt = Doubt(int(cycle.tick["doubt"])) if fault is Fault.ENCODER else Doubt.NONE
        legs = told | _legs(named[_NAMED_IN[fault]] if fault in _NAMED_IN else 0)
        causes[f"{fault.name}/{doubt.name}" if doubt else str(fault.name)] = legs
    return causes


def _legs(bits: int) -> frozenset[int]:
    return frozenset(leg for leg in range(LEGS) if bits >> leg & 1)


def _goes_on(cycle: Cycle, tick: int, rested: int, ended: int) -> bool:
    """Tell whether a run is watched for longer that could have ended first in a tick, and `rested` ticks ago.

    Where frames are lost, a held platform goes to closed brakes and comes back again and again.
    """
    rate = cycle.parts.rate_Hz
    if cycle.mode is Mode.HELD:
        return tick - min(cycle.mode_tick, ended) <= HELD_S * rate
    return cycle.mode is Mode.PARKED and rested <= REST_S * rate


def _longest_s(case: Case, durations: Durations) -> float:
    """Return after how long a case that has not ended is a failure: section engage may ask for minutes."""
    c, asked = case.configuration, (Mode.LOADING, Mode.RELEASING, Mode.PARKING, Mode.UNLOADING)
    stroke_m = c.platform.length_max_m - c.platform.length_min_m
    moves_s = max(stroke_m / c.engage.approach_speed_m_s, c.engage.blend_s) + case.track_s + c.engage.stop_s
    return LONGEST_S + sum(map(durations.least, asked)) + moves_s


def _run(case: Case) -> tuple[Trace | None, Ending]:
    """Return the run's trace, None if the fault did not begin, and how it ended."""
    c = case.configuration
    rate = c.loop.rate_Hz
    cycle = build_cycle(c, rate, c.drives.watchdog_ms * 1e-3)
    nodes, physics = build_nodes(c, FaultPlan([case.fault]))
    ticks: list[tuple[Array, Array, int, int]] = []
    named = dict.fromkeys((*_NAMED_IN.values(), "legs_lost"), 0)
    longest_s = _longest_s(case, cycle.durations)
    last = max(round(case.track_s * rate), 1)  # where the reference is fastest at once, it is followed first
    course, failure, tracked, rested = Course(cycle), "", 0, 0
    ending: Ending | None = None
    begun: int | None = None
    ended: int | None = None
    try:
        lockstep = build_lockstep(c, cycle, nodes)
        while ending is None:
            tick = lockstep.tick + 1
            tracked += cycle.mode is Mode.TRACKING
            stop = (Operator.STOP,) if tracked == last else ()
            starts_ns = nodes.schedule.starts_ns(case.fault)
            try:
                lockstep.step(course.commands(tick, stop))
            except PlantError as error:
                failure = str(error)
            if begun is None and nodes.now_ns >= starts_ns:
                begun = tick
            if failure:
                ending = course.failed(failure, tick)
                break
            ticks.append((nodes.snapshot().length, cycle.tick["q_d"].copy(), cycle.mode, cycle.faults))
            named = {name: bits | int(cycle.tick[name]) for name, bits in named.items()}
            ending = course.ending(tick)
            rested = 0 if ending is None else rested + 1
            ended = tick if ended is None and ending is not None else ended
            if ended is not None and _goes_on(cycle, tick, rested, ended):
                ending = None
            if tick >= longest_s * rate:
                raise RunError(f"it has not ended after {longest_s:.3g} s, in {cycle.mode.name}")
    finally:
        physics.close()
    if begun is None:
        return None, ending
    length, desired, mode, faults = (np.array(each) for each in zip(*ticks, strict=True))
    return Trace(
        length, desired, mode, faults, rate, begun, getattr(case.fault, "leg", None), ending.success, failure,
        _causes(cycle, ending, named), _legs(named["legs_lost"]),
    ), ending  # fmt: skip
