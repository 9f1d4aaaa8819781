"""An FMU of six uncoupled legs with the quirks of exporters, built from tests/data/legs.c."""

from __future__ import annotations

import subprocess
import zipfile
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from plant_fmu.stewart.build import find_compiler

MASS_KG, START_M = 200.0, 0.326
MAPPED = {"force": ["f"], "length": ["q"], "rate": ["v"], "brake": ["brake"]}
"""Keys of plant.model for these FMUs."""
_CHANNELS = {"f": ("input", "N"), "brake": ("input", ""), "q": ("output", "m"), "v": ("output", "m/s")}


@cache
def _compiled(*quirks: str) -> bytes:
    with TemporaryDirectory() as folder:
        out, source = Path(folder, "legs.so"), Path(__file__).parent / "data/legs.c"
        flags = ["-O1", "-shared", "-fPIC", "-fvisibility=hidden", *(f"-D{quirk}" for quirk in quirks)]
        subprocess.run([*find_compiler().command, *flags, "-o", str(out), str(source), "-lm"], check=True)
        return out.read_bytes()


def legs_fmu(
    out: Path,
    *quirks: str,
    brake: str | list[str] = "Real",
    name: str = "{}",
    experiment: str = "",
    cs: str = "",
) -> Path:
    """Build the FMU with macros of its source.

    brake: type of the brakes, or of each; name: of the members of the archive; experiment, cs: attributes of
    DefaultExperiment and CoSimulation.
    """
    brakes = [brake] * 6 if isinstance(brake, str) else brake
    rows = []
    for n, (channel, (causality, unit)) in enumerate(_CHANNELS.items()):
        for k in range(6):
            kind = brakes[k] if channel == "brake" else "Real"
            variability = "continuous" if kind == "Real" else "discrete"
            start = {"Boolean": ' start="false"'}.get(kind, ' start="0"') if causality == "input" else ""
            stated = f' unit="{unit}"' if unit else ""
            rows.append(
                f'<ScalarVariable name="{channel}[{k + 1}]" valueReference="{6 * n + k}" causality="{causality}" '
                f'variability="{variability}"><{kind}{stated}{start}/></ScalarVariable>'
            )
    xml = (
        '<fmiModelDescription fmiVersion="2.0" modelName="legs" guid="{1}" variableNamingConvention="structured">'
        f'<CoSimulation modelIdentifier="legs" {cs}/><DefaultExperiment {experiment}/>'
        f"<ModelVariables>{''.join(rows)}</ModelVariables><ModelStructure/></fmiModelDescription>"
    )
    with zipfile.ZipFile(out, "w") as archive:
        for member, data in (
            ("modelDescription.xml", xml.encode()),
            ("binaries/linux64/legs.so", _compiled(*quirks)),
        ):
            info = zipfile.ZipInfo()
            info.filename = name.format(member) if "{}" in name else member.replace("/", name)
            archive.writestr(info, data)
    return out
