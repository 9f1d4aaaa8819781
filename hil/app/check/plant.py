"""Figures of `hil check` about the FMU of a plant: its mapping, and its response to pushes."""

import numpy as np

from hil.app.check.report import Report
from hil.app.compose import build_nodes
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
