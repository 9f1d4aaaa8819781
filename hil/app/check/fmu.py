"""What `hil check` and `hil sim` say of an FMU as plant: units taken on trust, tool, brakes, coupling."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from drivers.arrays import Array
from hil.app.check.findings import Report
from hil.app.compose import build_nodes
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.robot.dynamics import Model
from plant_fmu.config import FmuPlant
from plant_fmu.fmu.archive import open_archive
from plant_fmu.fmu.check import fmu_spec, read_interface, shown
from plant_fmu.fmu.probe import Probe, probe

PUSH = 0.01
"""Share of limits.force_N that each leg is pushed with."""


def report_fmu(report: Report, c: Configuration) -> None:
    """Add how the FMU is mapped and how it answers small pushes. Raises PlantError: it cannot be hosted."""
    if c.plant is None or not isinstance(c.plant.model, FmuPlant):
        return
    model = c.plant.model
    spec = fmu_spec(model, c.folder)
    with open_archive(Path(spec.path)) as archive:
        face = read_interface(archive.namelist(), spec)
    description = face.description
    tool = shown(description.generationTool or "an unknown tool")
    assumed = [f"{key} {unit}" for key, unit in model.assume_unit.items()]
    stated = "units of force, length and rate are stated"
    answer = _probed(c)
    own, others = _shares(answer)
    report.sections["plant FMU"] = [
        f"{model.path}: FMI {shown(description.fmiVersion)}, made by {tool}",
        f"units ASSUMED of {len(face.assumed)} variables: {', '.join(assumed)}" if face.assumed else stated,
        f"one N in a leg accelerates it by {own:.4g} m/s^2, and others by up to {others:.4g}",
        f"without force its legs accelerate by up to {np.abs(answer.acceleration).max():.3g} m/s^2",
    ]
    report.figures["fmu"] = {
        "assumed_units": dict(face.assumed),
        "needs_execution_tool": bool(description.coSimulation.needsExecutionTool),
        "uncoupled": answer.uncoupled,
        "mobility_1_kg": answer.mobility.tolist(),
    }
    report.warnings += fmu_dangers(c)
    if description.coSimulation.needsExecutionTool:
        report.warnings.append(
            f"{model.path} needs {tool} at run time and is taken as plant.model.allow_execution_tool says: "
            "it runs in a child process, and where the tool is missing the run does not start"
        )
    report.warnings += coupling_dangers(c, answer)


def fmu_dangers(c: Configuration) -> Iterator[str]:
    """Yield that a plant without brakes falls before the first command."""
    if c.plant is None or not isinstance(c.plant.model, FmuPlant) or c.plant.model.brake:
        return
    load_N = float(np.abs(_static(c)).max())
    if load_N > 0.0:
        yield (
            "plant.model.brake is empty: no brake holds this plant, and its legs carry up to "
            f"{load_N:.3g} N; it falls from the first instant until the drives give force. Give the FMU six "
            "brake inputs (1 holds the leg) and map them, as the page on FMUs shows"
        )


def _static(c: Configuration) -> Array:
    """Return the forces (6,) N that hold the platform at home."""
    model, still = Model(build_platform(c.platform), leg_spin=c.platform.leg_spin), np.zeros(6)
    return model.inverse_dynamics(*pose_arrays(c.platform.home), still, still)


def _probed(c: Configuration) -> Probe:
    _, plant = build_nodes(c)
    try:
        return probe(plant, PUSH * c.limits.force_N, 1.0 / c.loop.rate_Hz)
    finally:
        plant.close()


def _shares(answer: Probe) -> tuple[float, float]:
    own = np.diag(answer.mobility)
    others = answer.mobility - np.diag(own)
    return float(np.abs(own).max()), float(np.abs(others).max())


def coupling_dangers(c: Configuration, answer: Probe) -> Iterator[str]:
    """Yield laws that linearise a platform which this plant is not, and legs that pull the wrong way."""
    if np.any(np.diag(answer.mobility) < 0.0):
        legs = ", ".join(str(i) for i in np.flatnonzero(np.diag(answer.mobility) < 0.0))
        yield (f"a force > 0 shortens leg {legs} of the FMU, and is to extend it: change the sign in the FMU")
    if answer.uncoupled and c.controller.believed is not None:
        m = 1.0 / np.abs(np.diag(answer.mobility)).min()
        yield (
            f"the legs of the FMU do not move each other, and controller.law {c.controller.law} compensates "
            "a platform between them that is not there: write controller.law: pd with gains of one leg, "
            f"kp_N_m = m wn^2 and kv_N_s_m = 2 m wn with m = {m:.3g} kg, and platform.gravity_m_s2: "
            "[0, 0, 0], as the shipped configuration bench does"
        )
