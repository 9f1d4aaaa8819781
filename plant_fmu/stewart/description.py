"""Model descriptions for FMI 2.0 and 3.0, and build description, from the variable table."""

from collections.abc import Sequence
from typing import Literal
from xml.etree import ElementTree as ET

from plant_fmu.stewart import can
from plant_fmu.stewart import variables as table
from plant_fmu.stewart.variables import VARIABLES, Variable

FmiVersion = Literal["2.0", "3.0"]
MODEL_IDENTIFIER = "stewart"
COMPILER_OPTIONS = "-O2 -funroll-loops -ffp-contract=off -fno-math-errno -std=c99"
"""No contraction: all machines of one family compute the same bits. No errno: a square root is then one
instruction; nothing reads errno."""
DESCRIPTION = (
    "Stewart-Gough platform with rigid-body legs, drives with force lag, brakes, friction and end stops. "
    "Forces in, leg lengths and rates out, SI units."
)


def document(root: ET.Element) -> bytes:
    """Text of an XML file with this root, indented."""
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _typed(
    parent: ET.Element,
    version: FmiVersion,
    tags: tuple[str, str, str],
    about: dict[str, str],
    numbers: dict[str, str],
) -> ET.Element:
    """Add an XML element whose type has attributes of its own.

    tags: outer and inner element of FMI 2.0, where the type is an element inside; the element of FMI 3.0.
    """
    outer, inner, whole = tags
    if version == "2.0":
        return ET.SubElement(ET.SubElement(parent, outer, about), inner, numbers)
    return ET.SubElement(parent, whole, {**about, **numbers})


def _types(root: ET.Element, version: FmiVersion, rows: Sequence[Variable]) -> None:
    units = ET.SubElement(root, "UnitDefinitions")
    for name, exponents in table.UNITS.items():
        unit = ET.SubElement(units, "Unit", name=name)
        ET.SubElement(unit, "BaseUnit", {base: str(n) for base, n in exponents.items()})
    types = ET.SubElement(root, "TypeDefinitions")
    used = {name for row in rows for name in (row.type, *row.types)} - {"Mixed"}
    for name, kind in table.TYPES.items():
        about = {"name": name, "description": kind.description}
        if name in used and kind.items:
            items = _typed(types, version, ("SimpleType", "Enumeration", "EnumerationType"), about, {})
            for value, item in enumerate(kind.items, start=1):
                ET.SubElement(items, "Item", name=item, value=str(value))
        elif name in used:
            number = int if kind.whole else float
            bounds = {key: number(x) for key, x in (("min", kind.min), ("max", kind.max)) if x is not None}
            given = {"unit": kind.unit} if kind.unit else {}
            of = {"quantity": kind.quantity, **given, **{key: str(x) for key, x in bounds.items()}}
            _typed(types, version, ("SimpleType", "Real", f"{kind.element}Type"), about, of)


_VARIABILITY: dict[table.Causality, dict[str, str]] = {
    "independent": {"variability": "continuous"},
    "parameter": {"variability": "fixed", "initial": "exact"},
    "input": {"variability": "continuous"},
    "output": {"variability": "continuous", "initial": "calculated"},
}


def _value(kind: str, start: Sequence[float] | None) -> dict[str, str]:
    value = {} if kind == "Mixed" else {"declaredType": kind}
    if unit := table.TYPES[kind].unit:
        value["unit"] = unit
    if start is not None:
        real = table.TYPES[kind].element == "Float64"
        value["start"] = " ".join(repr(float(x)) if real else str(int(x)) for x in start)
    return value


def model_description(
    version: FmiVersion,
    token: str,
    sources: Sequence[str],
    rows: Sequence[Variable] = VARIABLES,
    *,
    bus: bool = False,
) -> bytes:
    """Text of modelDescription.xml; rows: its variables; bus: it has a bus terminal, see `can`.

    FMI 3.0 has array variables, whose value reference is the row of the table. FMI 2.0 has one scalar
    ``name[i,j]`` per element, whose reference is its place, and lists the sources.
    """
    two = version == "2.0"
    about = {
        "fmiVersion": version,
        "modelName": "Stewart platform",
        ("guid" if two else "instantiationToken"): token,
        "description": can.DESCRIPTION if bus else DESCRIPTION,
        "version": "1",
        "license": "Apache-2.0",
        "generationTool": "hexapod-hil",
        "variableNamingConvention": "structured",
    }
    root = ET.Element("fmiModelDescription", about)
    state = "state" if two else "State"
    about = {
        "modelIdentifier": MODEL_IDENTIFIER,
        "canHandleVariableCommunicationStepSize": "true",
        f"canGetAndSetFMU{state}": "true",
        f"canSerializeFMU{state}": "true",
    }
    if bus:
        about["hasEventMode"] = "true"
    if two:
        files = ET.SubElement(ET.SubElement(root, "CoSimulation", about), "SourceFiles")
        for name in sources:
            ET.SubElement(files, "File", name=name)
    else:
        ET.SubElement(root, "CoSimulation", {**about, "fixedInternalStepSize": repr(table.INTERNAL_STEP)})
    _types(root, version, rows)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="Reason for a refused call")
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime="1", stepSize=repr(table.STEP_SIZE))
    keys = _variables(root, version, rows)
    structure = ET.SubElement(root, "ModelStructure")
    if bus:
        sent = can.bus_variables(root[-2], len(rows))
        ET.SubElement(structure, "Output", valueReference=sent)
        for tag in ("Output", "InitialUnknown"):  # without dependencies: each depends on all inputs
            for row in (row for row in rows if row.causality == "output"):
                ET.SubElement(structure, tag, valueReference=keys[row.name][0])
    else:
        _structure(structure, version, keys)
    return document(root)


def _variables(root: ET.Element, version: FmiVersion, rows: Sequence[Variable]) -> dict[str, list[str]]:
    """Add the variables; returns the keys of each row's elements in ModelStructure: index or reference."""
    two = version == "2.0"
    variables = ET.SubElement(root, "ModelVariables")
    keys: dict[str, list[str]] = {}
    for v in rows:
        parts = [(v.name, v.type, v.start)]
        if two:
            each = [None if v.start is None else v.start[k : k + 1] for k in range(v.size)]
            parts = [
                (table.element_name(v, k), v.types[k] if v.types else v.type, start)
                for k, start in enumerate(each)
            ]
        element = table.TYPES[v.type].element
        tag = "Real" if two and element == "Float64" else element
        first = sum(map(len, keys.values()))
        # The index of FMI 2.0 counts from 1.
        keys[v.name] = [str(first + two + k) for k in range(len(parts))]
        for k, (name, kind, start) in enumerate(parts):
            about = {"name": name, "valueReference": str(first + k), "description": v.description}
            about |= {"causality": v.causality, **_VARIABILITY[v.causality]}
            added = _typed(variables, version, ("ScalarVariable", tag, tag), about, _value(kind, start))
            for n in () if two else v.shape:
                ET.SubElement(added, "Dimension", start=str(n))
    return keys


def _structure(structure: ET.Element, version: FmiVersion, keys: dict[str, list[str]]) -> None:
    two = version == "2.0"
    outputs = [v for v in table.VARIABLES if v.causality == "output"]
    parameters = tuple(v.name for v in table.VARIABLES if v.causality == "parameter")
    for tag in ("Output", "InitialUnknown"):
        unknowns = ET.SubElement(structure, f"{tag}s") if two else structure
        for v in outputs:
            names = v.depends if tag == "Output" else (*(v.behind or parameters), *v.depends)
            for k, key in enumerate(keys[v.name]):
                depends = [each for name in names for each in keys[name]]
                if v.name == "applied_force":  # the force lag is per leg
                    depends = [keys[name][k % len(keys[name])] for name in names]
                about = {"dependencies": " ".join(depends)}
                about["dependenciesKind"] = " ".join(["dependent"] * len(depends))
                about = {("index" if two else "valueReference"): key, **about}
                ET.SubElement(unknowns, "Unknown" if two else tag, about)


def build_description(sources: Sequence[str]) -> bytes:
    """Text of sources/buildDescription.xml of FMI 3.0."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=MODEL_IDENTIFIER)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99", compilerOptions=COMPILER_OPTIONS)
    for name in sources:
        ET.SubElement(files, "SourceFile", name=name)
    return document(root)
