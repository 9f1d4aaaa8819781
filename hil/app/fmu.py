"""`hil fmu build`: the platform's physics as FMUs for co-simulation."""

from pathlib import Path
from typing import Any, Literal

from plant_fmu.stewart.build import build


def build_fmus(choice: Literal["2.0", "3.0", "both"], folder: Path | None = None) -> dict[str, Any]:
    """Build the FMUs, or take them from the cache, and copy them into `folder`; return the summary.

    Raises PlantError without a working compiler.
    """
    versions: tuple[Literal["2.0", "3.0"], ...] = ("2.0", "3.0") if choice == "both" else (choice,)
    built = {
        f"fmi_{version[0]}": str(
            build(version, None if folder is None else folder / f"stewart-fmi{version[0]}.fmu")
        )
        for version in versions
    }
    return {"success": True, "kind": "fmu build", **built}
