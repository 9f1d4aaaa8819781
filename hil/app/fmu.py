"""`hil fmu`: builds the platform's physics as FMUs, and proposes a mapping of another FMU's variables."""

from pathlib import Path
from typing import Any, Literal

from drivers.errors import ConfigurationError
from hil.app.compose import build_robot
from hil.app.configuration.configuration import Configuration, load
from hil.app.new.template import flow
from plant_fmu.config import StewartPlant
from plant_fmu.fmu.propose import Proposal, propose
from plant_fmu.stewart.build import build
from plant_fmu.stewart.plant import stewart_parameters


def build_fmus(folder: Path | None = None) -> dict[str, Any]:
    """Build the FMUs, or take them from the cache, copy them into `folder`, and return the summary.

    Raises PlantError without a working compiler.
    """
    versions: tuple[Literal["2.0", "3.0"], ...] = "2.0", "3.0"
    built = {
        f"fmi_{version[0]}": str(
            build(version, None if folder is None else folder / f"stewart-fmi{version[0]}.fmu")
        )
        for version in versions
    }
    return {"success": True, "kind": "fmu build", **built}


def can_parameters(c: Configuration) -> dict[str, Any]:
    """Start values of the CAN FMU for a configuration, by parameter name.

    Raises ConfigurationError for another protocol than `legs`, several buses, another plant than `stewart`.
    """
    c.require("sim")
    assert c.plant is not None
    model, drives, emulation = c.plant.model, c.drives, c.plant.drives
    if drives.protocol != "legs" or len(c.bus.buses) > 1 or not isinstance(model, StewartPlant):
        raise ConfigurationError(
            f"{c.source}: the CAN FMU has six drives of protocol legs on one bus and plant type stewart; "
            f"given: protocol {drives.protocol}, {len(c.bus.buses)} bus(es), plant type {model.type}"
        )
    return {
        **stewart_parameters(model, build_robot(c)),
        "layout": c.bus.layout,
        "node_id": drives.node_ids,
        "bitrate": c.bus.bitrate_bit_s,
        "data_bitrate": c.bus.data_bitrate_bit_s,
        "drive_force_limit": drives.force_limit_N,
        "encoder_resolution": emulation.encoder_resolution_m,
        "heartbeat": 1e-3 * drives.heartbeat_ms,
        "drive_damping": emulation.damping_N_s_m,
        "drive_stiffness": emulation.hold_stiffness_N_m,
        "brake_after": 1e-3 * drives.brake_after_ms,
        "brake_opening_time": 1e-3 * emulation.brake_open_ms,
        "brake_closing_time": 1e-3 * emulation.brake_close_ms,
    }


def build_can_fmu(configuration: Path, folder: Path | None = None) -> dict[str, Any]:
    """Build the CAN FMU for a configuration, copy it into `folder`, and return the summary.

    Raises ConfigurationError, and PlantError without a working compiler.
    """
    c = load(configuration)
    out = None if folder is None else folder / f"{c.name}-can.fmu"
    path = build("3.0", out, bus=can_parameters(c))
    return {"success": True, "kind": "fmu build", "can_fmu": str(path)}


def plant_section(path: str, proposal: Proposal) -> list[str]:
    """Section `plant.model` for an FMU, as lines of YAML without indentation.

    A key without a proposed variable is left empty, with a comment on what it needs.
    """
    needed = {"force": "inputs, N, > 0 extends", "length": "outputs, m", "rate": "outputs, m/s"}
    lines = ["type: fmu", f"path: {flow(path)}", "isolation: child_process"]
    if proposal.needs_tool:
        lines.append(f"allow_execution_tool: true   # needs {proposal.tool} at run time")
    for key, what in needed.items():
        names = proposal.mapped.get(key, ())
        lines.append(f"{key}: {flow(names)}   # {what}" + ("" if names else ": name six in leg order"))
    brakes = proposal.mapped.get("brake", ())
    lines.append(
        f"brake: {flow(brakes)}   # inputs, 1 holds the leg" + ("" if brakes else ": none, it falls")
    )
    if proposal.unstated:
        lines.append(f"assume_unit: {flow(proposal.unstated)}   # the FMU states none")
    return lines


def show_fmu(path: Path) -> tuple[list[str], dict[str, Any]]:
    """(lines that `hil fmu show` prints, summary). Raises PlantError if the FMU cannot be read."""
    proposal = propose(path)
    lines = [
        f"{path}: FMI {proposal.fmi}, made by {proposal.tool}",
        *([f"  {proposal.obstacle}"] if proposal.obstacle else []),
        *(f"  {variable}" for variable in proposal.variables),
        f"parameters: {', '.join(proposal.parameters) or 'none'}",
        "proposed mapping, to be checked before use:",
        "plant:",
        "  model:",
        *(f"    {line}" for line in plant_section(path.name, proposal)),
    ]
    summary = {"mapped": {key: list(names) for key, names in proposal.mapped.items()}}
    return lines, {"success": True, "kind": "fmu show", **summary, "missing": list(proposal.missing)}
