"""Checks of an FMU's model description against our requirements, before any of its code is loaded.

Each error message states what the FMU offers.
"""

import io
import math
import re
import zipfile
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import fmpy
from fmpy.model_description import read_model_description

from drivers.errors import PlantError
from plant_fmu.config import FmuPlant
from plant_fmu.fmu.archive import PARSED, open_archive

FLOATS = {"Real", "Float64"}
MAX_REFERENCE = 2**32 - 1
"""Value references are unsigned 32-bit numbers in both standards."""
_INTEGERS = {f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)} | {
    "Integer",
    "Enumeration",
}
SWITCHES = {"Boolean", *_INTEGERS} - {"Enumeration"}
"""Types of a brake that is no real number."""
_INDEX = re.compile(r"[0-9]{1,9}")
_SI = {"N": (1, 1, -2), "N.m": (1, 2, -2), "m": (0, 1, 0), "m/s": (0, 1, -1)}
"""Unit -> exponents of kg, m, s."""
_SPELLINGS = {"N.m": {"N.m", "Nm", "N*m", "N m"}, "m/s": {"m/s", "m.s-1", "m*s-1"}}


Parameter = float | int | bool | str | list[float]


class FmuSpec(FmuPlant):
    """Settings of an FMU to host, with an absolute path."""

    type: Literal["fmu"] = "fmu"
    truth: list[str] = []
    """Outputs with position, rotation, twist and applied forces; empty if unknown."""
    rod_force: str = ""
    """Output with the forces between drives and rods; empty if unknown."""


def fmu_spec(settings: FmuPlant, folder: Path) -> FmuSpec:
    """FMU settings for hosting; a relative path starts at `folder`, that of the configuration file."""
    return FmuSpec(**settings.model_dump() | {"path": str(folder / settings.path)})


@dataclass(frozen=True)
class Start:
    """One parameter of an FMU to set before initialisation."""

    name: str
    setter: str
    """Type name of the setting function: Real, Float64, Integer, ..."""
    references: tuple[int, ...]
    values: tuple[float | int | bool | str, ...]


@dataclass(frozen=True)
class Interface:
    """Variables, binary and start values of one FMU, as hosting needs them."""

    description: Any
    """ModelDescription of fmpy."""
    major: int
    library: str
    """Path of the shared library inside the archive."""
    inputs: dict[str, tuple[int, ...]]
    """force, and wrench and brake if the FMU has them, brake last -> value references of six values."""
    set_brake: tuple[str, int] | None
    """(setter, bytes per value) of brake inputs that are integer or Boolean; None if they are real."""
    outputs: dict[str, tuple[int, ...]]
    """length, rate, and the truth if it is known -> value references."""
    rod_force: tuple[int, ...]
    """Value references of the forces between drives and rods; none if unknown."""
    starts: tuple[Start, ...]
    assumed: dict[str, str]
    """Variable -> unit from the configuration, as the description declares none."""

    def unfit_step(self, step_s: float) -> str:
        """Text if steps of `step_s` s differ from the step that the description fixes; empty if they fit."""
        face, experiment = self.description.coSimulation, self.description.defaultExperiment
        stated = getattr(face, "fixedInternalStepSize", None)
        if stated is None and experiment and not face.canHandleVariableCommunicationStepSize:
            stated = experiment.stepSize
        with suppress(ValueError):
            own_s = float(stated or 0.0)
            if 0.0 < own_s < math.inf and abs(step_s / own_s - max(1, round(step_s / own_s))) >= 1e-9:
                fit_s = own_s * math.ceil(step_s / own_s - 1e-9)
                return (
                    f"its own step is {own_s:g} s and does not divide plant.model.step_us {1e6 * step_s:g}: "
                    "it refuses to step, or its outputs stand still between its own steps. Write plant.model."
                    f"step_us: {1e6 * fit_s:g} with a loop.rate_Hz of at most {1.0 / fit_s:g}, or export it "
                    f"with a step of {step_s:g} s"
                )
        return ""


def shown(text: str) -> str:
    """A text from a description, safe to print: in one line, unprintable characters escaped."""
    return text if text.isprintable() else repr(text)[1:-1]


def stated_unit(variable: Any) -> str | None:
    """Unit that an FMU's variable or its type declares; None without one."""
    of_type = None if variable.declaredType is None else variable.declaredType.unit
    return variable.unit or of_type or None


def reference(path: str, name: str, stated: str) -> int:
    """Value reference of a variable as a number, from its text. Raises PlantError if it is invalid."""
    if stated.isascii() and stated.isdigit() and int(stated) <= MAX_REFERENCE:
        return int(stated)
    raise PlantError(
        f"{path}: variable {name!r} has the valueReference {stated!r}; 0 to {MAX_REFERENCE} are allowed"
    )


class Reader:
    """Finds and checks variables of an FMU. Mutable state: the units that were assumed."""

    def __init__(self, description: Any, path: str, assume_unit: Mapping[str, str]) -> None:
        """assume_unit: unit of a variable or key whose description declares none."""
        self.path, self.assume_unit = path, assume_unit
        self.assumed: dict[str, str] = {}
        self.major = major(description)
        self.units = {u.name: u for u in description.unitDefinitions}
        self.by_name: dict[str, Any] = {v.name: v for v in description.modelVariables}

    def find(self, name: str) -> list[Any]:
        """A variable by its name, or in FMI 2 the elements ``name[..]`` of an array, sorted by index."""
        if name in self.by_name:
            return [self.by_name[name]]
        elements = [v for n, v in self.by_name.items() if self.major < 3 and n.startswith(f"{name}[")]
        if elements:
            return sorted(elements, key=lambda v: [int(n) for n in _INDEX.findall(v.name, len(name))])
        close = sorted(n for n in self.by_name if name.lower().split("[")[0] in n.lower())[:8]
        some = shown(", ".join(close or sorted(self.by_name)[:12]))
        hint = f"; similar names: {some}" if close else f"; it has {some} ..."
        raise PlantError(f"{self.path}: the FMU has no variable {name!r}{hint}")

    def reference(self, variable: Any) -> int:
        """Value reference of a variable, as a number. Raises PlantError if it is invalid."""
        return reference(self.path, variable.name, str(variable.valueReference))

    def _check_unit(self, key: str, variable: Any, allowed: Sequence[str]) -> None:
        """Check the declared unit of a variable, or assume the configured one; arrays have one for all."""
        name, needed = stated_unit(variable), f"{' or '.join(allowed)} is needed"
        if name is None:
            names = (variable.name, variable.name.split("[")[0], key)
            name = next((self.assume_unit[n] for n in names if n in self.assume_unit), None)
            if name is None and key in {"wrench", "truth"}:
                return
            if name is None:
                raise PlantError(
                    f"{self.path}: variable {variable.name!r} declares no unit; {needed}: hil drives no "
                    "force or length in an unknown unit. Export it with units; if you know that it is in "
                    f"{allowed[0]}, write assume_unit: {{{key}: {allowed[0]}}} next to its path"
                )
            fits = name in allowed
            self.assumed[variable.name] = name
        elif (base := getattr(self.units.get(name), "baseUnit", None)) is None:
            fits = any(name in _SPELLINGS.get(want, {want}) for want in allowed)
        else:
            scaled = (base.factor, base.offset) != (1, 0) or any((base.A, base.K, base.mol, base.cd))
            fits = not scaled and (base.kg, base.m, base.s) in {_SI[want] for want in allowed}
        if not fits:
            raise PlantError(
                f"{self.path}: variable {variable.name!r} is in {name!r}; {needed}. "
                "Convert it inside the FMU: hil does not convert units"
            )

    def channel(
        self,
        key: str,
        names: Sequence[str],
        causality: str,
        units: Sequence[str],
        count: int = 6,
        types: Collection[str] = FLOATS,
    ) -> tuple[int, ...]:
        """Value references of `names`, with `count` values in total. Raises PlantError if one is unfit."""
        found = [v for name in names for v in self.find(name)]
        for variable in found:
            if variable.causality != causality:
                raise PlantError(
                    f"{self.path}: {key}: variable {variable.name!r} is of causality {variable.causality}; "
                    f"{causality} is needed"
                )
            if variable.type not in types or variable.type != found[0].type:
                also = "" if types is FLOATS else ", or Boolean or an integer; all six of one type"
                raise PlantError(
                    f"{self.path}: {key}: variable {variable.name!r} is of type {variable.type}; "
                    f"Real (FMI 2) or Float64 (FMI 3) is needed{also}"
                )
            if units:
                self._check_unit(key, variable, units)
        total = sum(math.prod(v.shape or ()) for v in found)
        if total != count:
            raise PlantError(
                f"{self.path}: {key}: {list(names)} are {total} values; {count} are needed, "
                "as scalars in leg order or as one array"
            )
        references = tuple(map(self.reference, found))
        if len(set(references)) != len(references):
            raise PlantError(f"{self.path}: {key}: one variable is mapped twice in {list(names)}")
        return references

    def start(self, name: str, value: Parameter) -> Start:
        """Parameter `name` with its value converted to the variable's type. Raises PlantError."""
        found = self.find(name)
        first = found[0]
        values = list(value) if isinstance(value, list) else [value]
        if first.variability == "constant" or first.causality not in {"parameter", "input"}:
            raise PlantError(
                f"{self.path}: parameters: {name!r}: causality {first.causality}; only parameters can be set"
            )
        total = sum(math.prod(v.shape or ()) for v in found)
        if total != len(values):
            raise PlantError(
                f"{self.path}: parameters: {name!r} has {total} elements but {len(values)} are given"
            )
        kind = first.type
        try:
            cast = tuple(self._cast(first, x) for x in values)
        except (OverflowError, TypeError, ValueError):  # overflow: inf, and an integer beyond all floats
            raise PlantError(
                f"{self.path}: parameters: {name!r} is of type {kind}; {value!r:.60} is not a valid value"
            ) from None
        if kind == "Enumeration":
            kind = "Integer" if self.major < 3 else "Int64"
        return Start(name, kind, tuple(map(self.reference, found)), cast)

    def _cast(self, variable: Any, value: float | bool | str) -> float | int | bool | str:
        """A configured value converted to the variable's type. Raises ValueError."""
        kind = variable.type
        if kind in FLOATS or kind == "Float32":
            return float(value)
        if kind in _INTEGERS:  # an enumeration also accepts the names of its items
            items = enumerate(variable.declaredType.items if variable.declaredType else (), start=1)
            named = {item.name: i if item.value is None else int(item.value) for i, item in items}
            number = named.get(value, value)
            if isinstance(number, bool) or float(number) != int(number):
                raise ValueError(number)
            return int(number)
        if kind == "Boolean" and isinstance(value, bool):
            return value
        if kind == "String":
            return str(value)
        raise ValueError(kind)


def major(description: Any) -> int:
    """Major FMI version of a description: 2 or 3."""
    return int(description.fmiVersion.split(".")[0])


def library(description: Any, members: Sequence[str], path: Path) -> str:
    """Path of this machine's shared library in the archive; members: names in the archive.

    FMI 2.0 has folders for x86 processors only; on ARM `linux64` may hold a binary of another processor.
    Raises PlantError if there is no binary for this machine.
    """
    file = f"{description.coSimulation.modelIdentifier}{fmpy.sharedLibraryExtension}"
    candidates = [f"binaries/{fmpy.platform_tuple}/{file}"]
    if major(description) < 3:
        candidates.insert(not fmpy.platform_tuple.startswith("x86"), f"binaries/{fmpy.platform}/{file}")
    for candidate in candidates:
        if candidate in members:
            return candidate
    offered = sorted({m.split("/")[1] for m in members if m.startswith("binaries/") and m.count("/") >= 2})
    raise PlantError(
        f"{path}: the FMU has no binary for this machine ({shown(candidates[-1])}); it has binaries for "
        f"{shown(', '.join(offered)) or 'none'}. Export it for {fmpy.platform_tuple} or compile its sources"
    )


def described(path: Path) -> tuple[Any, list[str]]:
    """Model description of an FMU, as FMPy reads it, and the names in the archive.

    Raises PlantError on a file that `open_archive` refuses, a description that cannot be read, an unsupported
    FMI version, and an FMU without co-simulation interface.
    """
    read = io.BytesIO()  # fmpy knows no other names than these
    try:
        with open_archive(path) as archive, zipfile.ZipFile(read, "w") as parsed:
            members = archive.namelist()
            for member in archive.infolist():
                if member.filename in PARSED:
                    parsed.writestr(member.filename, archive.read(member))
        description = read_model_description(read, validate=False)
    except PlantError:
        raise
    except Exception as error:  # fmpy and lxml raise many types on malformed XML
        raise PlantError(f"{path}: modelDescription.xml cannot be read: {shown(str(error))}") from error
    version = description.fmiVersion
    if version != "2.0" and not version.startswith("3.0"):
        raise PlantError(f"{path}: FMI {shown(version)}; 2.0 and 3.0 can be hosted")
    if description.coSimulation is None:
        raise PlantError(f"{path}: the FMU has no co-simulation interface; export it for co-simulation")
    return description, members


def read_interface(spec: FmuSpec) -> Interface:
    """Interface of an FMU (variables, binary, start values), checked against `spec`.

    Checked are FMI version, co-simulation, a binary for this machine, the parameters, and for each mapped
    variable existence, causality, type, unit and number of elements. Raises PlantError with the variable, its
    property and the required one.
    """
    path = Path(spec.path)
    description, members = described(path)
    binary = library(description, members, path)
    if description.coSimulation.needsExecutionTool and not spec.allow_execution_tool:
        tool = shown(description.generationTool or "the tool that made it")
        raise PlantError(
            f"{path}: the FMU needs {tool} at run time (needsExecutionTool); export a stand-alone "
            "FMU or, if that tool is on this machine, write plant.model.allow_execution_tool: true"
        )
    reader = Reader(description, spec.path, spec.assume_unit)
    inputs = {"force": reader.channel("force", spec.force, "input", ("N",))}
    if spec.wrench:
        inputs["wrench"] = reader.channel("wrench", spec.wrench, "input", ("N", "N.m"))
    set_brake = None
    if spec.brake:
        inputs["brake"] = reader.channel("brake", spec.brake, "input", (), types=FLOATS | SWITCHES)
        kind = reader.find(spec.brake[0])[0].type
        if kind in SWITCHES:
            bits = re.search("[0-9]+$", kind)
            size = int(bits[0]) // 8 if bits else 4 if reader.major < 3 else 1  # fmi2Boolean is an int
            set_brake = f"fmi{reader.major}Set{kind}", size
    outputs = {
        "length": reader.channel("length", spec.length, "output", ("m",)),
        "rate": reader.channel("rate", spec.rate, "output", ("m/s",)),
    }
    for name, count in zip(spec.truth, (3, 9, 6, 6), strict=False):
        outputs[name] = reader.channel("truth", [name], "output", (), count)
    starts = tuple(reader.start(name, value) for name, value in spec.parameters.items())
    rod = reader.channel("truth", [spec.rod_force], "output", ()) if spec.rod_force else ()
    return Interface(
        description, reader.major, binary, inputs, set_brake, outputs, rod, starts, reader.assumed
    )
