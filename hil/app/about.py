"""`hil --version`: what a bug report needs."""

import hashlib
from pathlib import Path

import hil
from drivers.errors import PlantError
from drivers.files import cache_folder
from hil.record.environment import environment, product_version, scheduling
from plant_fmu.stewart.build import find_compiler, shipped, token


def about(*, verbose: bool) -> list[str]:
    """Lines on this installation. verbose : with machine, rights, packages, FMU and caches."""
    first = f"hil, version {product_version()}"
    if not verbose:
        return [first]
    files = {"fmu": _fmu(), "caches": str(cache_folder()), "installed": str(Path(hil.__file__).parents[1])}
    facts = environment() | scheduling() | files
    return [first, *(f"{key}: {value}" for key, value in facts.items() if key != "version")]


def _fmu() -> str:
    if path := shipped("3.0"):
        return f"{path}, sha256 {hashlib.sha256(path.read_bytes()).hexdigest()}"
    try:
        return f"token {token('3.0')}, built with {find_compiler().identity.splitlines()[1]}"
    except PlantError as error:
        return str(error)
