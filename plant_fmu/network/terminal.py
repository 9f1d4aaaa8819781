"""Bus terminal of a CAN FMU: its four variables, read from terminalsAndIcons.xml and checked."""

import math
import xml.etree.ElementTree as ET
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import PlantError
from plant_fmu.fmu.archive import MAX_XML_BYTES, open_archive
from plant_fmu.fmu.check import described, library, major, reference, shown

KIND, RULE = "org.fmi-ls-bus.network-terminal", "org.fmi-ls-bus.transceiver"
MIME = "application/org.fmi-standard.fmi-ls-bus.can"
_FILE = "terminalsAndIcons/terminalsAndIcons.xml"
_MEMBERS = {
    "Rx_Data": ("Binary", (("input", None),)),
    "Rx_Clock": ("Clock", (("input", "triggered"),)),
    "Tx_Data": ("Binary", (("output", None),)),
    "Tx_Clock": ("Clock", (("output", "triggered"), ("input", "countdown"))),
}
"""Member name -> type, and its pairs of causality and interval variability."""


@dataclass(frozen=True)
class CanFmu:
    """A CAN FMU with one of its networks as its description declares them, before its code is loaded."""

    path: Path
    description: Any
    """ModelDescription of fmpy."""
    library: str
    step_ns: int
    """Length, ns, of its communication steps; 0 if it takes any."""
    references: dict[str, int]
    """Member of the terminal -> value reference."""
    countdown: bool
    """True if the Tx clock is an input of kind countdown, False if it is a triggered output."""
    most_bytes: int
    """Largest binary that Rx_Data takes; a large number if the FMU states none."""
    most_sent: int
    """Likewise, that Tx_Data gives."""
    notifications: int | None
    """Boolean parameter BusNotifications; None if the FMU has none that can be set."""
    structural: bool
    """True if BusNotifications is set in configuration mode."""


def read_can_fmu(path: Path, terminal: str = "") -> CanFmu:
    """Read and check the CAN FMU at `path`.

    terminal: name of one of its CAN terminals; empty for its only one.

    The version in MIME types is not compared: nodes of the beta releases have the same bytes. Raises
    PlantError with the terminals or the property that does not fit.
    """
    description, names = described(path)
    interface = description.coSimulation
    if major(description) < 3 or not interface.hasEventMode:
        raise PlantError(
            f"{path}: not a CAN FMU: it needs FMI 3.0 with hasEventMode; this is FMI "
            f"{description.fmiVersion}, hasEventMode {str(bool(interface.hasEventMode)).lower()}"
        )
    if interface.needsExecutionTool:
        raise PlantError(f"{path}: the FMU needs its tool at run time; export a stand-alone FMU")
    with open_archive(path) as archive:
        root, declared = (_parsed(path, archive, names, file) for file in (_FILE, "modelDescription.xml"))
    variables = {each.get("name", ""): each for each in declared.iterfind("ModelVariables/*")}
    can: dict[str, ET.Element] = {}
    for each in root.iter("Terminal"):
        sent = variables.get(_members(each).get("Tx_Data", ""))
        mime = "" if sent is None else sent.get("mimeType", "").split(";")[0].strip()
        if (each.get("terminalKind"), each.get("matchingRule"), mime) == (KIND, RULE, MIME):
            can[each.get("name", "")] = each
    chosen = [name for name in can if terminal in {"", name}]
    if len(chosen) != 1:
        offered = shown(", ".join(can)) or "none"
        raise PlantError(f"{path}: CAN terminals: {offered}; choose one with FILE.fmu:TERMINAL")
    stated = None if description.defaultExperiment is None else description.defaultExperiment.stepSize
    fixed = float(interface.fixedInternalStepSize or stated or 0.001)
    if not 1e-9 <= fixed < math.inf:
        raise PlantError(f"{path}: its step is {fixed:g} s; at least 1 ns is needed")
    variable = interface.canHandleVariableCommunicationStepSize
    node = can[chosen[0]]
    found = _checked(path, node, variables)
    inner = [_members(each).get("BusNotifications", "") for each in node.iterfind("Terminal")]
    switch = next((variables[each] for each in inner if each in variables), None)
    causality = "" if switch is None else switch.get("causality", "local")
    settable = switch is not None and causality in {"parameter", "structuralParameter"}
    sizes = (found[each].get("maxSize", "") for each in ("Rx_Data", "Tx_Data"))
    most_bytes, most_sent = (int(each) if each.isdigit() and int(each) else 1 << 20 for each in sizes)
    return CanFmu(
        path,
        description,
        library(description, names, path),
        step_ns=0 if variable else round(fixed * 1e9),
        references={member: _reference(path, each) for member, each in found.items()},
        countdown=found["Tx_Clock"].get("intervalVariability") == "countdown",
        most_bytes=most_bytes,
        most_sent=most_sent,
        notifications=_reference(path, switch) if switch is not None and settable else None,
        structural=causality == "structuralParameter",
    )


def _parsed(path: Path, archive: zipfile.ZipFile, names: list[str], file: str) -> ET.Element:
    if file not in names or archive.getinfo(file).file_size > MAX_XML_BYTES:
        raise PlantError(f"{path}: no {file}, or it is too large; a CAN FMU declares its bus terminals there")
    try:
        return ET.fromstring(archive.read(file))  # noqa: S314 - no other file is read, and the size is bounded
    except (ET.ParseError, zipfile.BadZipFile) as error:
        raise PlantError(f"{path}: {file} cannot be read: {error}") from error


def _members(node: ET.Element) -> dict[str, str]:
    found = node.iterfind("TerminalMemberVariable")
    return {each.get("memberName", ""): each.get("variableName", "") for each in found}


def _checked(path: Path, node: ET.Element, variables: dict[str, ET.Element]) -> dict[str, ET.Element]:
    """Variables of a terminal by member. Raises PlantError for a missing or unfit one."""
    found: dict[str, ET.Element] = {}
    for member, (kind, ways) in _MEMBERS.items():
        variable = variables.get(_members(node).get(member, ""))
        way = None if variable is None else (variable.get("causality"), variable.get("intervalVariability"))
        if variable is None or variable.tag != kind or way not in ways:
            raise PlantError(
                f"{path}: terminal {shown(node.get('name', ''))}: {member} is missing or not of type {kind}, "
                f"(causality, intervalVariability) {' or '.join(map(str, ways))}"
            )
        found[member] = variable
    return found


def _reference(path: Path, variable: ET.Element) -> int:
    return reference(str(path), variable.get("name", ""), variable.get("valueReference", ""))
