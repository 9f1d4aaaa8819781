"""Compile every Numba kernel into the cache, so that parallel test processes find them compiled."""

from __future__ import annotations

from importlib import import_module
from pkgutil import walk_packages

PACKAGES = "drivers", "plant_fmu", "hil"


def modules() -> list[str]:
    """Names of all modules of the project; importing a module compiles its kernels."""
    return [
        module.name
        for package in PACKAGES
        for module in walk_packages(import_module(package).__path__, f"{package}.")
        if not module.name.endswith("__main__")
    ]


if __name__ == "__main__":
    for name in modules():
        import_module(name)
