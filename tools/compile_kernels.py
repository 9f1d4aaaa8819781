"""Every kernel compiled into the cache: else test processes side by side would each compile the same ones."""

from __future__ import annotations

from importlib import import_module
from pkgutil import walk_packages

PACKAGES = "drivers", "plant_fmu", "hil"


def modules() -> list[str]:
    """Return the names of all modules of the project; importing one compiles its kernels."""
    return [
        module.name
        for package in PACKAGES
        for module in walk_packages(import_module(package).__path__, f"{package}.")
        if not module.name.endswith("__main__")
    ]


if __name__ == "__main__":
    for name in modules():
        import_module(name)
