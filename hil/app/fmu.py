"""`hil fmu`: builds the platform's physics as FMUs, and proposes a mapping of another FMU's variables."""

from pathlib import Path
from typing import Any, Literal

from hil.app.new.template import flow
from plant_fmu.fmu.propose import Proposal, propose
from plant_fmu.stewart.build import build


def build_fmus(choice: Literal["2.0", "3.0", "both"], folder: Path | None = None) -> dict[str, Any]:
    """Build the FMUs, or take them from the cache, copy them into `folder`, and return the summary.

    Raises PlantError without a working compiler.
    """
    versions: tuple[Literal["2.0", "3.0"], ...] = ("2.0", "3.0") if choice == "both" else (choice,)
    built = {
        f"fmi_{version[0]}": str(
            build(version, None if folder is None else folder / f"stewart-fmi{version[0]}.fmu")
        )
        for version in versions
    }
    return {"success": True, "kind": "fmu build", **built}


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
