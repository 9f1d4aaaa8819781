"""Simulates one case of `hil faults`: one injected fault at one moment of a run."""

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
from hil.study.faults.diagnoses import COMMANDS_LOST, FOREIGN_COMMANDS
from hil.study.faults.verdict import REST_S, Bounds, Trace, judge, see
from plant_fmu.faults.plan import FaultPlan

LONGEST_S = 60.0
"""Time limit of a case, s, in addition to the durations in its configuration."""
HELD_S = 3.0
"""Observation time, s, of a platform that is held with force."""
NO_LATCH = "obey commands of any sender, even after our stop command"
"""Weakness of the families whose `stop_latches` is False."""
_NAMED_IN = {
    Fault.BRAKE: "legs_moved",
    Fault.ENCODER: "legs_doubted",
    Fault.DRIVE: "legs_refused",
    Fault.DUPLICATE_NODE: "doubled",
    Fault.SET_UP: "altered",
}
"""Columns that also list legs of a fault in later ticks than its first."""


class Job(NamedTuple):
    """A case of `hil faults` with the bounds that its reaction must keep."""

    case: Case
    bounds: Bounds


def run_case(job: Job) -> dict[str, Any]:
    """Simulate a case; return its outcome as plain values. Key `success`: the reaction kept its bounds."""
    begun = time.perf_counter()
    try:
        with collector_paused():
            found = _judged(job)
    except HilError as error:
        found = failed(job, str(error))
    return found | {"wall_s": time.perf_counter() - begun}


def failed(job: Job, why: str = "its process died") -> dict[str, Any]:
    """Outcome of a case that could not be simulated; why: the reason."""
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
    verdict += "" if good else _weakness(kind, build_protocol(c.bus, c.drives))
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


def _weakness(kind: str, protocol: Family) -> str:
    """Weakness of the drives that explains why a bound was exceeded, as text; empty if there is no such."""
    if kind in COMMANDS_LOST and not protocol.traits.has_watchdog:
        return f"; the drives {NO_WATCHDOG}"
    return f"; the drives {NO_LATCH}" if kind in FOREIGN_COMMANDS and not protocol.traits.stop_latches else ""


def _causes(cycle: Cycle, ending: Ending, named: dict[str, int]) -> dict[str, frozenset[int]]:
    """{fault, ENCODER with its kind of error: legs} reported in a run.

    named : for each column of `_NAMED_IN`, the bits of all ticks.
    """
    findings = () if ending.story is None else ending.story.findings
    causes: dict[str, frozenset[int]] = {}
    for fault in Fault(ending.faults):
        ours = (each.leg for each in findings if each.fault == fault.name)
        reported = frozenset(leg for leg in ours if leg is not None)
        doubt = Doubt(int(cycle.tick["doubt"])) if fault is Fault.ENCODER else Doubt.NONE
        legs = reported | _legs(named[_NAMED_IN[fault]] if fault in _NAMED_IN else 0)
        causes[f"{fault.name}/{doubt.name}" if doubt else str(fault.name)] = legs
    return causes


def _legs(bits: int) -> frozenset[int]:
    return frozenset(leg for leg in range(LEGS) if bits >> leg & 1)


def _still_observed(cycle: Cycle, tick: int, rested: int, ended: int) -> bool:
    """True if a run that could have ended is observed further, to see whether the legs stay at rest.

    rested : number of ticks in a row in which it could have ended; ended : first such tick. If frames are
    lost, a held platform repeatedly changes between force and closed brakes.
    """
    rate = cycle.parts.rate_Hz
    if cycle.mode is Mode.HELD:
        return tick - min(cycle.mode_tick, ended) <= HELD_S * rate
    return cycle.mode is Mode.PARKED and rested <= REST_S * rate


def _longest_s(case: Case, durations: Durations) -> float:
    """Time limit of a case, s, with the durations that section `engage` requires, which may be minutes."""
    c, timed = case.configuration, (Mode.LOADING, Mode.RELEASING, Mode.PARKING, Mode.UNLOADING)
    stroke_m = c.platform.length_max_m - c.platform.length_min_m
    moves_s = max(stroke_m / c.engage.approach_speed_m_s, c.engage.blend_s) + case.track_s + c.engage.stop_s
    return LONGEST_S + sum(map(durations.least, timed)) + moves_s


def _run(case: Case) -> tuple[Trace | None, Ending]:
    """Simulate a case; return its trace (None: the fault did not begin) and its end."""
    c = case.configuration
    rate = c.loop.rate_Hz
    cycle = build_cycle(c, rate, c.drives.watchdog_ms * 1e-3)
    nodes, physics = build_nodes(c, FaultPlan([case.fault]))
    ticks: list[tuple[Array, Array, int, int]] = []
    named = dict.fromkeys((*_NAMED_IN.values(), "legs_lost"), 0)
    longest_s = _longest_s(case, cycle.durations)
    last = max(round(case.track_s * rate), 1)  # a reference that is fastest at once is tracked, too
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
            if ended is not None and _still_observed(cycle, tick, rested, ended):
                ending = None
            if tick >= longest_s * rate:
                raise RunError(f"the run has not ended after {longest_s:.3g} s; mode: {cycle.mode.name}")
    finally:
        physics.close()
    if begun is None:
        return None, ending
    length, desired, mode, faults = (np.array(each) for each in zip(*ticks, strict=True))
    return Trace(
        length, desired, mode, faults, rate, begun, getattr(case.fault, "leg", None), ending.success, failure,
        _causes(cycle, ending, named), _legs(named["legs_lost"]),
    ), ending  # fmt: skip
