"""`hil --version`: what a bug report needs."""

import hashlib
from importlib.metadata import PackageNotFoundError, distribution

from drivers.errors import PlantError
from drivers.files import cache_folder
from hil.record.environment import environment, product_version, scheduling
from plant_fmu.stewart.build import find_compiler, shipped, token


def about(*, verbose: bool) -> list[str]:
    """Lines on this installation. verbose : with machine, rights, packages, FMU and caches."""
    first = f"hil, version {product_version()}"
    if not verbose:
        return [first]
    facts = environment() | scheduling() | {"fmu": _fmu(), "caches": _caches(), "installed": _installed()}
    return [first, *(f"{key}: {value}" for key, value in facts.items() if key != "version")]


def _fmu() -> str:
    if path := shipped("3.0"):
        return f"{path}, sha256 {hashlib.sha256(path.read_bytes()).hexdigest()}"
    try:
        compiler = find_compiler().identity.splitlines()[1]
    except PlantError as error:
        return str(error)
    return f"token {token('3.0')}, built with {compiler}"


def _caches() -> str:
    files = [path.stat().st_size for path in cache_folder().rglob("*") if path.is_file()]
    return f"{cache_folder()}, {len(files)} files, {sum(files) / 1e6:.1f} MB"


def _installed() -> str:
    try:
        return str(distribution("hexapod-hil").locate_file(""))
    except PackageNotFoundError:
        return "not installed, imported from the sources"
