"""CAN FMUs for tests, built from `node.c` by the compiler that also builds the plant's FMU."""

import re
import subprocess
import zipfile
from pathlib import Path

import fmpy

from plant_fmu.stewart.build import find_compiler

_C = Path(__file__).with_name("node.c")
_MIME = "application/org.fmi-standard.fmi-ls-bus.can; version=&quot;1.0.0&quot;"
_CLOCKS = {
    True: '<Clock name="Can0.Tx_Clock" valueReference="4" causality="input" intervalVariability="countdown"/>',
    False: '<Clock name="Can0.Tx_Clock" valueReference="4" causality="output" intervalVariability="triggered"/>',
}


def description(countdown: bool) -> str:
    data = f'variability="discrete" maxSize="2048" mimeType="{_MIME}"'
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="node" instantiationToken="{{node}}"
 variableNamingConvention="structured"><CoSimulation modelIdentifier="node" hasEventMode="true"
 canHandleVariableCommunicationStepSize="true"/><ModelVariables>
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


def build_node(folder: Path, identifier: int, *, countdown: bool = True, **macros: int) -> Path:
    """CAN FMU that sends `identifier` each PERIOD_NS from OFFSET_NS on; macros as in node.c."""
    settings = {"PERIOD_NS": 1_000_000, "OFFSET_NS": 1_000_000, "BITRATE": 500_000, "DISCARD": 0}
    settings |= {"IDENTIFIER": identifier} | ({"COUNTDOWN": 1} if countdown else {}) | macros
    out, library = folder / f"node{identifier:X}.fmu", folder / f"node{identifier:X}.so"
    headers = Path(fmpy.__file__).parent / "c-code"
    defines = [
        f"-D{name}={value}LL" if name.endswith("_NS") else f"-D{name}={value}"
        for name, value in settings.items()
    ]
    stubs = folder / "stubs.c"  # FMPy wants every function of the standard
    declared = re.findall(r"TYPE +(fmi3\w+);", (headers / "fmi3Functions.h").read_text())
    own = _C.read_text()
    names = [name for name in declared if f"{name}(" not in own]
    stubs.write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in names))
    command = [
        *find_compiler().command,
        "-O1",
        "-shared",
        "-fPIC",
        f"-I{headers}",
        *defines,
        str(_C),
        str(stubs),
    ]
    subprocess.run([*command, "-o", str(library), "-lm"], check=True, capture_output=True)
    binary = f"binaries/{fmpy.platform_tuple}/node{fmpy.sharedLibraryExtension}"
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("modelDescription.xml", description(countdown))
        archive.writestr("terminalsAndIcons/terminalsAndIcons.xml", terminals("Can0"))
        archive.write(library, binary)
    return out
