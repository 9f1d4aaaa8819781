"""`hil new`: writes a configuration from the user's answers, without copying from another robot."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from drivers.errors import ConfigurationError
from drivers.files import real_path
from hil.app.configuration.configuration import Configuration, loads, short_name
from hil.app.configuration.schema import schema_line
from hil.app.files import printable
from hil.app.new import derive
from hil.app.new.robot import Answers, home_height_m
from hil.app.new.template import SECTIONS, filled
from plant_fmu.fmu.propose import Proposal, propose

FMU_PARAMETERS = {
    "mass": "mass_kg", "com_height": "com_height_m", "base_radius": "base_radius_m",
    "base_half_angle_deg": "base_half_angle_deg", "platform_radius": "platform_radius_m",
    "platform_half_angle_deg": "platform_half_angle_deg",
}  # fmt: skip
"""FMU parameter and its value in the template, set where the FMU has it; also gravity_x, inertia_x, to _z."""


def new_configuration(
    answers: Answers, path: Path, fmu: tuple[Path, Proposal] | None = None
) -> tuple[str, Configuration]:
    """(text, parsed configuration) from answers, to be stored at `path`.

    fmu: the plant in place of ours, as read by `recognised`. Raises ConfigurationError: the derived
    configuration is invalid.
    """
    values = derive.values(answers) | {"name": short_name(path)}
    if fmu is None:
        values |= {
            "stewart": True,
            "rubs": bool(values["coulomb_friction_N"] or values["viscous_friction_N_s_m"]),
        }
    else:
        values |= _fmu_values(values, fmu[1], _named(fmu[0], path.parent))
    only_sim = fmu is None and answers["interface"] != "localcan"
    values |= {"sim_only": only_sim, "local": not only_sim}
    file = printable(shlex.quote(str(path)))
    head = f"""{schema_line()}
#
# Written by `hil new`. Next: `hil check {file}`, then `hil sim {file}`.
# Numbers without a comment, on their line or on their section, are answers. The others follow by
# the rule next to them, or are usual; replace them as you learn more of your robot. Lengths are
# from joint centre to joint centre.
#"""
    sections = filter(None, (filled(section, values) for section in SECTIONS))
    text = "\n\n".join([head, *sections]) + "\n"
    return text, loads(text, str(path), path.parent)


def recognised(fmu: Path) -> Proposal:
    """Proposed mapping of an FMU's variables to leg forces, lengths and rates.

    Raises PlantError: not an FMU; ConfigurationError: six variables each of force, length and rate not found.
    """
    proposal = propose(fmu)
    if proposal.missing:
        raise ConfigurationError(
            f"{fmu}: six variables each are needed for force, length and rate, and none were recognised for "
            f"{', '.join(proposal.missing)}; `hil fmu show {fmu}` lists the variables: name them in "
            "plant.model by hand in a configuration that `hil new` wrote without --fmu"
        )
    return proposal


def _named(fmu: Path, folder: Path) -> str:
    """Path of an FMU in a configuration in `folder`: relative to the folder if the FMU is below it."""
    file, folder = real_path(fmu), real_path(folder)
    return str(file.relative_to(folder) if file.is_relative_to(folder) else file)


def _fmu_values(values: dict[str, Any], proposal: Proposal, path: str) -> dict[str, Any]:
    known = {"mass": values["mass_kg"]}
    if "circles" in values:
        known = {name: values[key] for name, key in FMU_PARAMETERS.items()}
        known["home_height"] = home_height_m(values)
    known |= {f"inertia_{axis}": values["inertia"][k][k] for k, axis in enumerate("xyz")}
    known |= {f"gravity_{axis}": values["gravity"][k] for k, axis in enumerate("xyz")}
    lost = [name for name in proposal.parameters if name.startswith("gravity_")]
    if lost == ["gravity_z"] and any(values["gravity"][:2]):
        raise ConfigurationError(
            f"{path}: has gravity_z only, but gravity is {values['gravity']} m/s^2 in the base frame: add "
            "gravity_x and gravity_y to the FMU's parameters, or give --mounting standing or hanging"
        )
    return {
        "path": path,
        "needs_tool": proposal.needs_tool,
        **{key: list(proposal.mapped.get(key, ())) for key in ("force", "length", "rate", "brake")},
        "assume_unit": dict(proposal.unstated),
        "parameters": {name: float(x) for name, x in known.items() if name in proposal.parameters},
    }
