"""`hil compare CONFIG`: simulates all laws on one platform with one trajectory, load and model error."""

import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import ConfigurationError
from hil.app.compose import build_nodes
from hil.app.configuration.changes import unattended
from hil.app.configuration.compare import CompareSettings, DisturbanceSettings
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.fault_rules import without_effect
from hil.app.configuration.platform import build_platform
from hil.app.output import further, picture_path
from hil.app.reachability import span_s
from hil.control import ControllerSettings
from hil.record.metrics import Share, force_shares
from hil.robot.dynamics import Model
from hil.study.compare.claims import judge
from hil.study.compare.crossover import equal_crossover, gains, loop_of
from hil.study.compare.laws import changed, chosen, desired_loop, paths, with_scale, without_limits
from hil.study.compare.measure import SETTLE_PERIODS, Job, Outcome, measure
from hil.study.compare.plot import draw
from hil.study.workers import Progress, perform
from hil.trajectory.build import build_trajectory
from plant_fmu.config import BenchPlant

OWN = "own"
"""Unchanged path of the configuration, on which the rows of the table are measured."""
SHARE_SAMPLES = 2001
"""Instants along the reference at which the terms of the force are evaluated."""


def compare(
    c: Configuration,
    *,
    laws: Sequence[str] | None = None,
    path_laws: Sequence[str] | None = None,
    duration_s: float | None = None,
    lift_limits: bool = False,
    equal: bool = False,
    jobs: int | None = None,
    picture: Path | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure laws along a configuration's reference and at home, draw them, and return the summary.

    laws : names; default: section `compare`, else all.
    path_laws : names of the laws that also run with signal losses removed, or `all` or `none`; default: the
        configuration's own law. Losses: bus time, encoder resolution, drive lag.
    duration_s : along the reference; default one period of it.
    lift_limits : run without the limits of tracking error, force change and speed.
    equal : scale the gains of the laws to one crossover, see `crossover.equal_crossover`.
    jobs : number of processes; default one per processor, 1: this process.

    A law that faults keeps its row. Raises ConfigurationError: the configuration cannot run; PlantError: the
    plant cannot be opened; LogError: the picture cannot be created. If writing it fails at the end, the
    summary keeps the figures and the reason, see `further`.
    """
    begun = time.perf_counter()
    c.require("sim")
    c = unattended(c).model_copy(update={"feedforward": None})  # learned with one of the laws
    target = picture_path(c.recording.folder, f"{c.name}-compare", picture)
    settings = chosen(c, laws)
    extra = _path_laws(c, settings, path_laws)
    believed = {name: with_scale(s, c.compare.inertia_scale) for name, s in settings.items()}
    crossover, remarks = None, dict[str, str]()
    if equal:
        crossover, believed, remarks = equal_crossover(c, believed)
    compared = without_limits(c) if lift_limits else c
    duration = _duration(c, duration_s)
    _refuse_load(c, duration)
    build_nodes(c)[1].close()  # once, before each law would fail
    work = _jobs(compared, believed, extra, duration)
    done = {(o.law, o.path): o for o in perform(work, measure, _died, jobs, progress)}
    own = {name: done[name, OWN] for name in settings}
    losses = {
        name: {job.path: done[name, job.path] for job in work if job.law == name and job.path != OWN}
        | {"as configured": own[name]}
        for name in extra
    }
    shares = _shares(c, duration)
    claims = judge(own, believed, shares) if shares else []
    ours = own.get(c.controller.law)
    result = {
        "success": not any(o.fault and not o.figures for o in done.values()) and not (ours and ours.fault),
        "kind": "compare",
        "configuration": c.source,
        "duration_s": duration,
        "limits": "lifted" if lift_limits else "as configured",
        "inertia_scale": c.compare.inertia_scale,
        **c.compare.model_dump(include={"disturbance", "step"}),
        "equal_crossover_rad_s": crossover,
        "laws": {
            name: {
                "settings": believed[name].model_dump(),
                "gains": gains(believed[name]),
                **loop_of(c, believed[name])._asdict(),
                "remark": remarks.get(name),
                **_plain(o),
            }
            for name, o in own.items()
        },
        "paths": {name: {path: _plain(o) for path, o in found.items()} for name, found in losses.items()},
        "force_shares": {name: share._asdict() for name, share in shares.items()},
        "claims": claims,
        "picture": None,
    }
    with further(result):
        result["picture"] = str(draw(own, losses, target, _title(c, crossover, lift_limits=lift_limits)))
    return result | {"wall_s": time.perf_counter() - begun}


def with_options(
    c: Configuration,
    *,
    inertia_scale: float | None = None,
    wrench: tuple[float, float, float, float, float, float] | None = None,
    wrench_at_s: float = 0.0,
) -> Configuration:
    """Configuration with command-line options in section `compare`; wrench: N, N m; None keeps a value."""
    load = wrench and DisturbanceSettings(force_N=wrench[:3], moment_N_m=wrench[3:], start_s=wrench_at_s)
    given = {"compare.inertia_scale": inertia_scale, "compare.disturbance": load}
    return changed(c, {key: value for key, value in given.items() if value is not None})


def _path_laws(
    c: Configuration, settings: dict[str, ControllerSettings], names: Sequence[str] | None
) -> list[str]:
    if names is None:
        return [c.controller.law] if c.controller.law in settings else []
    if tuple(names) in {("all",), ("none",), ()}:
        return list(settings) if "all" in names else []
    unknown = [name for name in names if name not in settings]
    if unknown:
        raise ConfigurationError(
            f"--paths: {', '.join(unknown)} is not among the compared laws: {', '.join(settings)}"
        )
    return list(names)


def _duration(c: Configuration, given: float | None) -> float:
    trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
    whole, period = trajectory.duration_s, span_s(trajectory)
    if given is not None:
        return given if whole is None else min(given, whole)
    if not period:
        raise ConfigurationError(
            f"{c.source}: reference: has no end, but a comparison needs one: add --duration"
        )
    return period


def _refuse_load(c: Configuration, duration: float) -> None:
    """Refuse a load that the plant cannot apply, or that begins after the end of the reference."""
    d = c.compare.disturbance
    if d is not None and c.plant is not None and (why := without_effect(c.plant, "wrench_step")):
        raise ConfigurationError(f"{c.source}: compare.disturbance (--wrench): {why}")
    if d is not None and d.start_s >= duration:
        raise ConfigurationError(
            f"{c.source}: compare.disturbance.start_s (--wrench-at): the reference ends before the load "
            f"begins, allowed: less than {duration:g}, given: {d.start_s:g}"
        )


def _jobs(
    c: Configuration, settings: dict[str, ControllerSettings], extra: Iterable[str], duration: float
) -> list[Job]:
    settle = max(SETTLE_PERIODS / desired_loop(c).wn, 0.3)
    step, disturbance = c.compare.step, c.compare.disturbance
    ours = {name: changed(c, {"controller": each}) for name, each in settings.items()}
    work = [Job(name, OWN, own, duration, disturbance, step, settle) for name, own in ours.items()]
    return work + [
        Job(name, path, other, duration, disturbance, None, settle)
        for name in extra
        for path, other in paths(ours[name]).items()
        if other != ours[name]  # the last one is the row of the table
    ]


def _died(job: Job) -> Outcome:
    return Outcome(job.law, job.path, "its process died", None, {}, {})


def _shares(c: Configuration, duration: float) -> dict[str, Share]:
    """Shares of the exact model's terms in the leg force along the reference; empty without a platform."""
    assert c.plant is not None
    if isinstance(c.plant.model, BenchPlant):  # legs without a platform
        return {}
    trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
    model = Model(build_platform(c.platform), leg_spin=c.platform.leg_spin)
    # Just inside the end, where the path still moves: outside it rests.
    times = np.linspace(0.0, duration * (1 - 1e-12), SHARE_SAMPLES)
    return force_shares(model, map(trajectory.sample, times.tolist()))


def _plain(o: Outcome) -> dict[str, Any]:
    return {"fault": o.fault, "fault_s": o.fault_s, **o.figures}


def _title(c: Configuration, crossover_rad_s: float | None, *, lift_limits: bool) -> str:
    s: CompareSettings = c.compare
    parts = [f"{c.name}: control laws along the reference"]
    if crossover_rad_s is not None:
        parts.append(f"crossover {crossover_rad_s:.3g} rad/s")
    if s.inertia_scale != 1.0:
        parts.append(f"masses of the models {100 * s.inertia_scale:g} %")
    if (d := s.disturbance) is not None:
        force, moment = (f"({', '.join(f'{x:g}' for x in v)})" for v in (d.force_N, d.moment_N_m))
        parts.append(f"load {force} N, {moment} N m from {d.start_s:g} s")
    return "; ".join(parts + ["limits lifted"] * lift_limits)
