"""`hil check CONFIG`: prints figures and warnings about a configuration before anything moves."""

from collections.abc import Callable

import numpy as np

from hil.app.check import figures, sensing
from hil.app.check.report import Report
from hil.app.check.subject import controlled_stop_m, course, looked_at, reacted_to
from hil.app.check.warnings import warnings
from hil.app.compose import build_nodes
from hil.app.configuration.configuration import Configuration
from plant_fmu.config import FmuPlant

PUSH = 0.01
"""Push on each leg, as a share of limits.force_N."""


def plant(r: Report) -> None:
    """Add the mapping of an FMU and its response to small pushes.

    Raises PlantError: it, or a CAN FMU of drives, cannot be hosted.
    """
    s, c = r.s, r.s.c
    if c.plant is not None and c.plant.drives.fmu is not None:
        build_nodes(c)[1].close()
    if c.plant is None or not isinstance(c.plant.model, FmuPlant):
        return
    from plant_fmu.fmu.check import fmu_spec, read_interface, shown  # noqa: PLC0415 - FMU tools, where one is the plant
    from plant_fmu.fmu.probe import probe  # noqa: PLC0415

    model = c.plant.model
    spec = fmu_spec(model, c.folder)
    face = read_interface(spec)
    description = face.description
    _, hosted = build_nodes(c)
    try:
        s.probe = answer = probe(hosted, PUSH * c.limits.force_N, s.period_s)
        s.notes, s.unfit_step = hosted.notes(), face.unfit_step(spec.step_us / 1e6)
    finally:
        hosted.close()
    s.tool = shown(description.generationTool or "an unknown tool")
    s.needs_tool = bool(description.coSimulation.needsExecutionTool)
    r.figures["fmu"] = {
        "assumed_units": dict(face.assumed),
        "needs_execution_tool": s.needs_tool,
        "uncoupled": answer.uncoupled,
        "mobility_1_kg": answer.mobility.tolist(),
    }
    own, assumed = np.diag(answer.mobility), ""
    if face.assumed:
        units = ", ".join(f"{key} {unit}" for key, unit in model.assume_unit.items())
        assumed = f"units ASSUMED of {len(face.assumed)} variables: {units}"
    r.add(
        "plant FMU",
        """
        {c.plant.model.path}: FMI {version}, made by {s.tool}
        {units}
        one N in a leg accelerates it by {own:.4g} m/s^2, and others by up to {others:.4g}
        without force its legs accelerate by up to {falls:.3g} m/s^2
        """,
        version=shown(description.fmiVersion),
        units=assumed or "units of force, length and rate are stated",
        own=np.abs(own).max(),
        others=np.abs(answer.mobility - np.diag(own)).max(),
        falls=np.abs(answer.acceleration).max(),
    )


SECTIONS: tuple[Callable[[Report], None], ...] = (
    figures.robot, figures.bus, figures.drives, figures.transmission, figures.controller, figures.stability,
    sensing.monitor, sensing.encoders, sensing.fusion, figures.reference, figures.operating, figures.payload,
    figures.feedforward, plant, figures.permissions,
)  # fmt: skip


def inspect(c: Configuration, tell: Callable[[float, float], None] = lambda *_: None) -> Report:
    """Report of `hil check` on a configuration and its whole reference.

    tell: progress callback, called with checked and total seconds of the reference. Raises
    ConfigurationError: each limit that the reference violates, with the first instant; PlantError: an FMU
    that cannot be hosted.
    """
    report = Report(looked_at(c, tell))
    for section in SECTIONS:
        section(report)
    for code, text in warnings(report.s):
        report.codes.append(code)
        report.warnings.append(text)
    return report


def refuse_unreachable(c: Configuration) -> None:
    """Refuse a reference that violates a limit anywhere on its path; takes up to half a second.

    Raises ConfigurationError with the first instant of each violated limit.
    """
    course(c)


def stopping_distances_m(c: Configuration) -> tuple[float, float]:
    """Longest leg travels on the reference, m: after silence until the brake holds; in a controlled stop.

    Silence: commands no longer reach the drives. Drives whose watchdog this program does not set have no
    bound; a reaction within `drives.watchdog_ms` is assumed then. Raises ConfigurationError as `inspect`.
    """
    *_, w = course(c)
    return reacted_to(c, w).travel_m(w), controlled_stop_m(c, w)
