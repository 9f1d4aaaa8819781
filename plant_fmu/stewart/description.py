"""Model descriptions for FMI 2.0 and 3.0, build description and terminals, from the variable table."""

from collections.abc import Sequence
from typing import Literal
from xml.etree import ElementTree as ET

from plant_fmu.stewart.variables import (
    INTERNAL_STEP,
    LEG_SPIN,
    STEP_SIZE,
    TYPES,
    UNITS,
    VARIABLES,
    Causality,
    Variable,
    element_name,
    offsets,
    parameters_behind,
    type_of,
)

FmiVersion = Literal["2.0", "3.0"]
MODEL_IDENTIFIER = "stewart"
DESCRIPTION = (
    "Stewart-Gough platform with rigid-body legs, drives with force lag, brakes, friction and end stops. "
    "Forces in, leg lengths and rates out, SI units."
)


def _text(root: ET.Element) -> bytes:
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(x)) for x in values)


def _root(version: FmiVersion, token: str) -> ET.Element:
    return ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": version,
            "modelName": "Stewart platform",
            ("guid" if version == "2.0" else "instantiationToken"): token,
            "description": DESCRIPTION,
            "version": "1",
            "license": "Apache-2.0",
            "generationTool": "hexapod-hil",
            "variableNamingConvention": "structured",
        },
    )


def _units(root: ET.Element) -> None:
    units = ET.SubElement(root, "UnitDefinitions")
    for name, exponents in UNITS.items():
        unit = ET.SubElement(units, "Unit", name=name)
        ET.SubElement(unit, "BaseUnit", {base: str(n) for base, n in exponents.items()})


def _types(root: ET.Element, version: FmiVersion) -> None:
    types = ET.SubElement(root, "TypeDefinitions")
    for name, kind in TYPES.items():
        if name == "Mixed":
            continue
        about = {"name": name, "description": kind.description}
        bounds = {"unit": kind.unit, "min": kind.min, "max": kind.max}
        of = {"quantity": kind.quantity, **{k: str(v) for k, v in bounds.items() if v is not None}}
        if version == "2.0":
            ET.SubElement(ET.SubElement(types, "SimpleType", about), "Real", of)
        else:
            ET.SubElement(types, "Float64Type", {**about, **of})
    about = {"name": "LegSpin", "description": "What turns a leg about its own axis"}
    if version == "2.0":
        items = ET.SubElement(ET.SubElement(types, "SimpleType", about), "Enumeration")
    else:
        items = ET.SubElement(types, "EnumerationType", about)
    for value, item in enumerate(LEG_SPIN, start=1):
        ET.SubElement(items, "Item", name=item, value=str(value))


_VARIABILITY: dict[Causality, dict[str, str]] = {
    "independent": {"variability": "continuous"},
    "parameter": {"variability": "fixed", "initial": "exact"},
    "input": {"variability": "continuous"},
    "output": {"variability": "continuous", "initial": "calculated"},
}


def _about(v: Variable) -> dict[str, str]:
    return {"description": v.description, "causality": v.causality, **_VARIABILITY[v.causality]}


def _value(kind: str, start: Sequence[float] | None) -> dict[str, str]:
    """Return type, unit and start value of a variable or an element."""
    value = {} if kind == "Mixed" else {"declaredType": kind}
    if kind in TYPES and (unit := TYPES[kind].unit):
        value["unit"] = unit
    if start is not None:
        value["start"] = str(int(start[0])) if kind == "LegSpin" else _numbers(start)
    return value


def _dependencies(depends: Sequence[str]) -> dict[str, str]:
    return {"dependencies": " ".join(depends), "dependenciesKind": " ".join(["dependent"] * len(depends))}


def _head(root: ET.Element, version: FmiVersion, sources: Sequence[str]) -> None:
    state = "State" if version == "3.0" else "state"
    step = {"fixedInternalStepSize": repr(INTERNAL_STEP)} if version == "3.0" else {}
    simulation = ET.SubElement(
        root,
        "CoSimulation",
        {
            "modelIdentifier": MODEL_IDENTIFIER,
            "canHandleVariableCommunicationStepSize": "true",
            f"canGetAndSetFMU{state}": "true",
            f"canSerializeFMU{state}": "true",
            **step,
        },
    )
    if version == "2.0":
        files = ET.SubElement(simulation, "SourceFiles")
        for name in sources:
            ET.SubElement(files, "File", name=name)
    _units(root)
    _types(root, version)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="Why a call was refused")
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime="1", stepSize=repr(STEP_SIZE))


def model_description_3(token: str) -> bytes:
    """Return modelDescription.xml of FMI 3.0: array variables, value reference = row of the table."""
    root = _root("3.0", token)
    _head(root, "3.0", ())
    reference = {v.name: str(i) for i, v in enumerate(VARIABLES)}
    variables = ET.SubElement(root, "ModelVariables")
    for v in VARIABLES:
        tag = "Enumeration" if v.type == "LegSpin" else "Float64"
        about = {"name": v.name, "valueReference": reference[v.name], **_about(v)}
        element = ET.SubElement(variables, tag, {**about, **_value(v.type, v.start)})
        for n in v.shape:
            ET.SubElement(element, "Dimension", start=str(n))
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [v for v in VARIABLES if v.causality == "output"]
    for v in outputs:
        behind = _dependencies([reference[name] for name in v.depends])
        ET.SubElement(structure, "Output", {"valueReference": reference[v.name], **behind})
    for v in outputs:
        behind = _dependencies([reference[name] for name in (*parameters_behind(v.name), *v.depends)])
        ET.SubElement(structure, "InitialUnknown", {"valueReference": reference[v.name], **behind})
    return _text(root)


def model_description_2(token: str, sources: Sequence[str]) -> bytes:
    """Return modelDescription.xml of FMI 2.0: one scalar ``name[i,j]`` per element, reference = its place."""
    root = _root("2.0", token)
    _head(root, "2.0", sources)
    place = offsets()
    variables = ET.SubElement(root, "ModelVariables")
    for v in VARIABLES:
        for k in range(v.size):
            about = {"name": element_name(v, k), "valueReference": str(place[v.name] + k), **_about(v)}
            scalar = ET.SubElement(variables, "ScalarVariable", about)
            tag = "Enumeration" if v.type == "LegSpin" else "Real"
            start = None if v.start is None else v.start[k : k + 1]
            ET.SubElement(scalar, tag, _value(type_of(v, k), start))
    by_name = {v.name: v for v in VARIABLES}

    def indices(names: Sequence[str]) -> list[str]:
        return [str(place[name] + k + 1) for name in names for k in range(by_name[name].size)]

    structure = ET.SubElement(root, "ModelStructure")
    for tag in ("Outputs", "InitialUnknowns"):
        unknowns = ET.SubElement(structure, tag)
        for v in VARIABLES:
            if v.causality != "output":
                continue
            names = v.depends if tag == "Outputs" else (*parameters_behind(v.name), *v.depends)
            for k in range(v.size):
                # The force lag is per leg: its output depends on its own command only.
                depends = indices(names)
                if v.name == "applied_force":
                    depends = [indices([n])[k if by_name[n].size > 1 else 0] for n in names]
                index = str(place[v.name] + k + 1)
                ET.SubElement(unknowns, "Unknown", {"index": index, **_dependencies(depends)})
    return _text(root)


def build_description(sources: Sequence[str]) -> bytes:
    """Return sources/buildDescription.xml of FMI 3.0."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=MODEL_IDENTIFIER)
    files = ET.SubElement(
        configuration,
        "SourceFileSet",
        language="C99",
        compilerOptions="-O2 -funroll-loops -ffp-contract=off -fno-math-errno -std=c99",
    )
    for name in sources:
        ET.SubElement(files, "SourceFile", name=name)
    return _text(root)


def terminals() -> bytes:
    """Return terminalsAndIcons.xml of FMI 3.0: one terminal per leg and one for the platform.

    A terminal member names a whole array variable; which element belongs to the leg is in its member name.
    """
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    group = ET.SubElement(root, "Terminals")
    for leg in range(1, 7):
        names = ("force", "brake", "length", "rate", "applied_force")
        members = {f"{name}[{leg}]": name for name in names}
        _terminal(group, f"leg{leg}", f"Drive and encoder of leg {leg}", members)
    names = ("wrench", "position", "rotation", "twist", "acceleration")
    _terminal(group, "platform", "Motion of the platform, wrench on it", dict(zip(names, names, strict=True)))
    return _text(root)


def _terminal(group: ET.Element, name: str, description: str, members: dict[str, str]) -> None:
    terminal = ET.SubElement(group, "Terminal", name=name, matchingRule="plug", description=description)
    for member, variable in members.items():
        about = {"variableName": variable, "memberName": member, "variableKind": "signal"}
        ET.SubElement(terminal, "TerminalMemberVariable", about)
