"""What `hil check` and `hil sim` say of an FMU as plant: units taken on trust, tool, brakes, coupling."""

from pathlib import Path

import numpy as np

from hil.app.check.report import Report
from hil.app.check.subject import Subject, robot, static_N
from hil.app.compose import build_nodes
from hil.app.configuration.configuration import Configuration
from plant_fmu.config import FmuPlant

PUSH = 0.01
"""Share of limits.force_N that each leg is pushed with."""


def plant(report: Report) -> None:
    """Add how an FMU is mapped and how it answers small pushes. Raises PlantError: it cannot be hosted."""
    s, c = report.s, report.s.c
    if c.plant is None or not isinstance(c.plant.model, FmuPlant):
        return
    from plant_fmu.fmu.archive import open_archive
    from plant_fmu.fmu.check import fmu_spec, read_interface, shown
    from plant_fmu.fmu.probe import probe

    model = c.plant.model
    spec = fmu_spec(model, c.folder)
    with open_archive(Path(spec.path)) as archive:
        face = read_interface(archive.namelist(), spec)
    description = face.description
    _, hosted = build_nodes(c)
    try:
        s.probe = answer = probe(hosted, PUSH * c.limits.force_N, s.period_s)
    finally:
        hosted.close()
    s.tool = shown(description.generationTool or "an unknown tool")
    s.needs_tool = bool(description.coSimulation.needsExecutionTool)
    report.figures["fmu"] = {
        "assumed_units": dict(face.assumed),
        "needs_execution_tool": s.needs_tool,
        "uncoupled": answer.uncoupled,
        "mobility_1_kg": answer.mobility.tolist(),
    }
    own, assumed = np.diag(answer.mobility), ""
    if face.assumed:
        units = ", ".join(f"{key} {unit}" for key, unit in model.assume_unit.items())
        assumed = f"units ASSUMED of {len(face.assumed)} variables: {units}"
    report.add(
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


def falls(c: Configuration) -> str:
    """Say that a plant without brakes falls before the first command; empty where it does not."""
    if c.plant is None or not isinstance(c.plant.model, FmuPlant) or c.plant.model.brake:
        return ""
    load_N = float(np.abs(static_N(c, robot(c))).max())
    if load_N == 0.0:
        return ""
    return (
        "plant.model.brake is empty: no brake holds this plant, and its legs carry up to "
        f"{load_N:.3g} N; it falls from the first instant until the drives give force. Give the FMU six "
        "brake inputs (1 holds the leg) and map them, as the page on FMUs shows"
    )


def backward(s: Subject) -> str:
    """Return the legs that a force > 0 shortens."""
    legs = [] if s.probe is None else np.flatnonzero(np.diag(s.probe.mobility) < 0.0).tolist()
    return ", ".join(map(str, legs))


def uncoupled(s: Subject) -> dict[str, float] | None:
    """Return the largest mass of uncoupled legs, if the law has a platform between them."""
    if s.probe is None or not s.probe.uncoupled or s.c.controller.believed is None:
        return None
    return {"m": float(1.0 / np.abs(np.diag(s.probe.mobility)).min())}
