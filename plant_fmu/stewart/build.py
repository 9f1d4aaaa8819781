"""Build of our .fmu: find a C compiler, compile the sources, pack and cache the result."""

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from drivers.errors import PlantError
from drivers.files import cache_folder, made_folder, whole_file
from plant_fmu.stewart import can
from plant_fmu.stewart.description import (
    COMPILER_OPTIONS,
    MODEL_IDENTIFIER,
    FmiVersion,
    build_description,
    model_description,
)
from plant_fmu.stewart.variables import VARIABLES, Variable, header, tables

SOURCES = Path(__file__).parent / "sources"
ATTACHED = Path(__file__).parent / "attached"
"""Files that go into the FMU as they are: documentation, icon, reference results."""
_OF_BOTH = ("icon.png", "documentation/licenses/license.txt")
_OF_BUS = (
    "terminalsAndIcons/terminalsAndIcons.xml",
    "extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml",
)
_ICON = {"2.0": "model.png", "3.0": "terminalsAndIcons/icon.png"}
_COMMON = ("mechanics.c", "contact.c", "plant.c", "plant.h", "face.h")
_DRIVES = ("drives.c", "drives.h", "frames.h", "terminal.h")
FLAGS = (*COMPILER_OPTIONS.split(), "-fvisibility=hidden", "-shared")
_PLAIN_2 = {"linux": "linux64", "windows": "win64", "darwin": "darwin64"}
_ZIP_DATE = (2000, 1, 1, 0, 0, 0)


class Target(NamedTuple):
    """A platform (operating system and processor) for which an FMU binary is built."""

    zig: str
    """Target triple for zig; without one zig compiles for the present CPU."""
    folder: str
    suffix: str


TARGETS: dict[str, Target] = {
    "linux-x86_64": Target("x86_64-linux-gnu.2.17", "x86_64-linux", ".so"),
    "linux-aarch64": Target("aarch64-linux-gnu.2.17", "aarch64-linux", ".so"),
    "windows-x86_64": Target("x86_64-windows-gnu", "x86_64-windows", ".dll"),
    "darwin-x86_64": Target("x86_64-macos", "x86_64-darwin", ".dylib"),
    "darwin-aarch64": Target("aarch64-macos", "aarch64-darwin", ".dylib"),
}


class Compiler(NamedTuple):
    """Command line of a C compiler, and what kind of compiler it is."""

    command: tuple[str, ...]
    zig: bool
    identity: str
    """Text that distinguishes compilers in the cache key."""


def this_machine() -> str:
    """Key of TARGETS for this machine. Raises PlantError on an unsupported machine."""
    key = f"{sys.platform}-{platform.machine()}"
    if key not in TARGETS:
        raise PlantError(f"no FMU binary can be built for {key}; allowed are {', '.join(TARGETS)}")
    return key


def _identity(command: tuple[str, ...], argument: str) -> str | None:
    try:
        answer = subprocess.run([*command, argument], capture_output=True, text=True, timeout=60, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{shlex.join(command)}\n{answer.stdout}"


def find_compiler(*, zig: bool = False) -> Compiler:
    """Command line of a C compiler: $CC, the system's cc, or zig from the package ziglang.

    zig: True to accept zig only. Raises PlantError, with what to install, if no compiler is found.
    """
    if not zig:
        wanted = os.environ.get("CC")
        found: tuple[str, ...] = ()
        with suppress(ValueError):  # unbalanced quotation marks
            found = tuple(shlex.split(wanted or shutil.which("cc") or ""))
        if found and (identity := _identity(found, "--version")):
            return Compiler(found, zig=False, identity=identity)
        if wanted:
            raise PlantError(f"the compiler in CC={wanted!r} does not run; correct or unset CC")
    if importlib.util.find_spec("ziglang") is not None:
        command = (sys.executable, "-m", "ziglang")
        if identity := _identity(command, "version"):
            return Compiler((*command, "cc"), zig=True, identity=identity)
    missing = "zig" if zig else "C compiler (cc, or zig from PyPI)"
    raise PlantError(
        f"no {missing} found to build the plant's FMU; install one of: pip install ziglang, apt install gcc"
    )


Bus = Mapping[str, Any] | None
"""Start values of the CAN FMU of drives and plant, see `can`; None for the plant alone."""


def _rows(bus: Bus) -> tuple[Variable, ...]:
    return VARIABLES if bus is None else can.can_rows(bus)


def _source_files(version: FmiVersion, bus: Bus = None) -> dict[str, bytes]:
    names = (*_COMMON, f"fmi{version[0]}.c", *(_DRIVES if bus is not None else ()))
    files = {name: (SOURCES / name).read_bytes() for name in names}
    defines = f"#define LS_BUS\n#define BUS_BYTES {can.BUS_BYTES}\n" if bus is not None else ""
    files["model.h"] = header(_rows(bus), defines).encode()
    files["model.c"] = tables("", _rows(bus)).encode()
    if bus is not None:
        files["legs.h"] = can.legs_header().encode()
    return files


def _digest(parts: dict[str, bytes]) -> str:
    total = hashlib.sha256()
    for name in sorted(parts):
        total.update(name.encode() + b"\0" + hashlib.sha256(parts[name]).digest())
    return total.hexdigest()


def _attached_files(version: FmiVersion, bus: Bus) -> dict[str, bytes]:
    """Contents by place in the FMU; the CAN FMU has other variables than page and reference results."""
    paths = {path.relative_to(ATTACHED).as_posix(): path for path in ATTACHED.rglob("*") if path.is_file()}
    names = [name for name in sorted(paths) if name in _OF_BOTH or (name in _OF_BUS) == (bus is not None)]
    return {(_ICON[version] if name == "icon.png" else name): paths[name].read_bytes() for name in names}


def shipped(version: FmiVersion) -> Path | None:
    """FMU that a wheel of a release contains, with binaries for all of TARGETS; None elsewhere."""
    path = Path(__file__).with_name(f"{MODEL_IDENTIFIER}_fmi{version[0]}.fmu")
    return path if path.is_file() else None


def token(version: FmiVersion, bus: Bus = None) -> str:
    """Instantiation token of the FMU: a hash of its sources and model description."""
    files = _source_files(version, bus)
    units = [name for name in files if name.endswith(".c")]
    xml = model_description(version, "", units, _rows(bus), bus=bus is not None)
    digest = _digest({**files, "modelDescription.xml": xml})
    return f"{{{uuid.uuid5(uuid.NAMESPACE_OID, digest)}}}"


def _compile(compiler: Compiler, key: str, folder: Path, units: list[str]) -> bytes:
    target = TARGETS[key]
    out = folder / f"{key}{target.suffix}"
    command = [*compiler.command, *FLAGS]
    if compiler.zig:
        command += ["-target", target.zig, "-s"]  # debugging information would name the folder
    if target.suffix == ".so":
        command += ["-fPIC"]
    command += ["-o", out.name, *units]  # a library for macOS names itself so
    if target.suffix != ".dll":
        command += ["-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise PlantError(
            f"compiling the plant for {key} failed with exit code {done.returncode}:\n"
            f"{shlex.join(command)}\n{done.stderr.strip()[-2000:]}"
        )
    return out.read_bytes()


def _pack(
    path: Path,
    version: FmiVersion,
    bus: Bus,
    binaries: dict[str, bytes],
    sources: dict[str, bytes],
    guid: str,
) -> None:
    units = sorted(name for name in sources if name.endswith(".c"))
    description = model_description(version, guid, units, _rows(bus), bus=bus is not None)
    members = {"modelDescription.xml": description}
    if version == "3.0":
        members["sources/buildDescription.xml"] = build_description(units)
    members |= {f"sources/{name}": data for name, data in sorted(sources.items())}
    members |= _attached_files(version, bus)
    for key, data in binaries.items():
        target = TARGETS[key]
        system, processor = key.split("-")
        # FMI 2.0 has folders for x86 processors only; importers on others use the x86 folder, too.
        plain = version == "2.0" and (processor == "x86_64" or len(binaries) == 1)
        folder = _PLAIN_2[system] if plain else target.folder
        members[f"binaries/{folder}/{MODEL_IDENTIFIER}{target.suffix}"] = data
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            entry = zipfile.ZipInfo(name, _ZIP_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)


def build(
    fmi_version: FmiVersion = "3.0",
    out: Path | None = None,
    *,
    release: bool = False,
    bus: Bus = None,
) -> Path:
    """Build our plant's FMU, or take it from the wheel or the cache; return its path.

    out: path for a copy; None returns that file itself. release: binaries for all of TARGETS,
    cross-compiled with zig; otherwise one for this machine. bus: start values of parameters, for the CAN FMU
    of drives and plant (FMI 3.0), see `can`. The same sources and compiler give the same bytes.

    Raises PlantError without a compiler, on a failed compilation, and if cache or copy cannot be written.
    """
    ready = shipped(fmi_version) if bus is None and not release else None
    fmu = ready or _built(fmi_version, bus, release=release)
    if out is None:
        return fmu
    try:
        with whole_file(out) as temporary:
            shutil.copyfile(fmu, temporary)
    except OSError as error:
        raise PlantError(f"{out}: the FMU cannot be written: {error.strerror or error}") from error
    return out


def _built(fmi_version: FmiVersion, bus: Bus, *, release: bool) -> Path:
    """Path of the FMU in the cache, where it is built if it is missing."""
    keys = list(TARGETS) if release else [this_machine()]
    compiler = find_compiler(zig=release)
    guid = token(fmi_version, bus)
    sources = _source_files(fmi_version, bus)
    sources["model.c"] = tables(guid, _rows(bus)).encode()
    recipe = repr((compiler.identity, FLAGS, keys, [TARGETS[k] for k in keys], fmi_version))
    attached = _attached_files(fmi_version, bus)
    digest = _digest({**sources, **attached, "recipe": recipe.encode() + Path(__file__).read_bytes()})
    cached = cache_folder() / "fmu" / digest[:24] / f"{MODEL_IDENTIFIER}_fmi{fmi_version[0]}.fmu"
    try:
        if not cached.is_file():
            made_folder(cached.parent)
            with tempfile.TemporaryDirectory(dir=cached.parent) as scratch:
                folder = Path(scratch)
                for name, data in sources.items():
                    (folder / name).write_bytes(data)
                units = sorted(name for name in sources if name.endswith(".c"))
                binaries = {key: _compile(compiler, key, folder, units) for key in keys}
                _pack(folder / cached.name, fmi_version, bus, binaries, sources, guid)
                (folder / cached.name).replace(cached)
    except OSError as error:
        raise PlantError(
            f"the FMU could not be written: {error}; set XDG_CACHE_HOME to a folder that can be written"
        ) from error
    return cached
