"""CAN FMUs for tests, built from `node.c` by the compiler that also builds the plant's FMU."""

import os
import re
import subprocess
import zipfile
from collections.abc import Mapping
from pathlib import Path

import fmpy
import pytest

from plant_fmu.stewart.build import find_compiler

_C, _DRIVE_C = (Path(__file__).with_name(name) for name in ("node.c", "legs_drive.c"))
_MIME = "application/org.fmi-standard.fmi-ls-bus.can; version=&quot;1.0.0&quot;"
_CLOCKS = {
    True: '<Clock name="Can0.Tx_Clock" valueReference="4" causality="input" intervalVariability="countdown"/>',
    False: '<Clock name="Can0.Tx_Clock" valueReference="4" causality="output" intervalVariability="triggered"/>',
}


def demo_node(clock: str) -> Path:
    """The demo FMU of fmi-ls-bus-examples whose Tx clock is `clock`; skips the test without it."""
    folder = os.environ.get("HIL_LS_BUS_FMUS")
    if not folder:
        pytest.skip("HIL_LS_BUS_FMUS is not set: the folder of the demo FMUs (docs/guides/can-fmus.md)")
    return Path(folder).resolve() / f"DemoCanNode{clock}.fmu"


def description(countdown: bool, fixed_step_ms: int = 0) -> str:
    step = "true" if not fixed_step_ms else f'false" fixedInternalStepSize="{1e-3 * fixed_step_ms}'
    data = f'variability="discrete" maxSize="2048" mimeType="{_MIME}"'
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="node" instantiationToken="{{node}}"
 variableNamingConvention="structured"><CoSimulation modelIdentifier="node" hasEventMode="true"
 canHandleVariableCommunicationStepSize="{step}"/><ModelVariables>
<Clock name="Can0.Rx_Clock" valueReference="3" causality="input" intervalVariability="triggered"/>
{_CLOCKS[countdown]}
<Binary name="Can0.Rx_Data" valueReference="1" causality="input" clocks="3" {data}><Start value=""/></Binary>
<Binary name="Can0.Tx_Data" valueReference="2" causality="output" clocks="4" {data}/>
</ModelVariables><ModelStructure><Output valueReference="2"/></ModelStructure></fmiModelDescription>"""


def terminals(*names: str) -> str:
    members = "".join(
        f'<TerminalMemberVariable variableKind="signal" variableName="Can0.{m}" memberName="{m}"/>'
        for m in ("Rx_Data", "Rx_Clock", "Tx_Data", "Tx_Clock")
    )
    body = "".join(
        f'<Terminal name="{name}" terminalKind="org.fmi-ls-bus.network-terminal" '
        f'matchingRule="org.fmi-ls-bus.transceiver">{members}</Terminal>'
        for name in names
    )
    return f'<fmiTerminalsAndIcons fmiVersion="3.0"><Terminals>{body}</Terminals></fmiTerminalsAndIcons>'


def build_node(folder: Path, identifier: int, *, countdown: bool = True, **macros: int | str) -> Path:
    """CAN FMU that sends `identifier` each PERIOD_NS from OFFSET_NS on; macros as in node.c."""
    settings: dict[str, int | str] = {
        "PERIOD_NS": 1_000_000,
        "OFFSET_NS": 1_000_000,
        "BITRATE": 500_000,
        "DISCARD": 0,
    }
    settings |= {"IDENTIFIER": identifier} | ({"COUNTDOWN": 1} if countdown else {}) | macros
    fixed = int(settings.pop("FIXED_STEP_MS", 0))
    return build(folder, _C, f"node{identifier:X}", settings, description(countdown, fixed))


def build_drives(folder: Path, *, drives: int = 6, **macros: int) -> Path:
    """CAN FMU of one drive, or six, of protocol `legs` in layout fd; macros as in legs_drive.c."""
    settings = {"DRIVES": drives, "ANSWER_NS": 0, "VERSION": 2, "FD_RATE": 5_000_000} | macros
    size = '<Dimension start="6"/>' if drives == 6 else ""
    real = 'variability="continuous"'
    own = (
        f'<Float64 name="length" valueReference="10" causality="input" {real} unit="m" start="0">{size}</Float64>'
        f'<Float64 name="rate" valueReference="11" causality="input" {real} unit="m/s" start="0">{size}</Float64>'
        f'<Float64 name="force" valueReference="12" causality="output" {real} unit="N">{size}</Float64>'
        f'<Boolean name="brake" valueReference="13" causality="output" variability="discrete">{size}</Boolean>'
        '<Int32 name="leg" valueReference="20" causality="parameter" variability="fixed" start="0"/>'
        '<Int32 name="crash_ms" valueReference="21" causality="parameter" variability="fixed" start="0"/>'
    )
    text = description(True).replace("</ModelVariables>", own + "</ModelVariables>")
    return build(folder, _DRIVE_C, f"drives{drives}", settings, text)


def build(folder: Path, source: Path, name: str, settings: Mapping[str, int | str], text: str) -> Path:
    """CAN FMU of a C file, compiled with macros `settings`; text: its modelDescription.xml."""
    out, library = folder / f"{name}.fmu", folder / f"{name}.so"
    headers = Path(fmpy.__file__).parent / "c-code"
    defines = [
        f"-D{name}={value}LL" if name.endswith("_NS") else f"-D{name}={value}"
        for name, value in settings.items()
    ]
    stubs = folder / "stubs.c"  # FMPy wants every function of the standard
    declared = re.findall(r"TYPE +(fmi3\w+);", (headers / "fmi3Functions.h").read_text())
    own = source.read_text() + source.with_name("can_node.h").read_text()
    names = [name for name in declared if f"{name}(" not in own]
    stubs.write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in names))
    command = [
        *find_compiler().command,
        "-O1",
        "-shared",
        "-fPIC",
        f"-I{headers}",
        *defines,
        str(source),
        str(stubs),
    ]
    subprocess.run([*command, "-o", str(library), "-lm"], check=True, capture_output=True)
    binary = f"binaries/{fmpy.platform_tuple}/node{fmpy.sharedLibraryExtension}"
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr("terminalsAndIcons/terminalsAndIcons.xml", terminals("Can0"))
        archive.write(library, binary)
    return out
