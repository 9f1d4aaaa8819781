"""`hil new`: a configuration from answers. Nothing in it is taken from another robot."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

from yaml.reader import Reader

from drivers.errors import ConfigurationError
from drivers.files import real_path
from hil.app.configuration.configuration import Configuration, loads, short_name
from hil.app.configuration.schema import schema_line
from hil.app.files import printable
from hil.app.new import derive
from hil.app.new.drives import counts_itself, drives_section, family
from hil.app.new.robot import LOWER_SHARE, platform_section, robot_at_home
from hil.app.new.text import yaml_text
from hil.config.reactions import ReactionSettings
from hil.mathematics.rounding import lowered, raised
from plant_fmu.fmu.propose import Proposal, propose

FMU_PARAMETERS: dict[str, Callable[[dict[str, Any], dict[str, Any]], float]] = {
    "mass": lambda a, _: a["mass_kg"],
    "com_height": lambda a, _: a["com_height_m"],
    "inertia_x": lambda _, p: p["platform"]["inertia_kg_m2"][0][0],
    "inertia_y": lambda _, p: p["platform"]["inertia_kg_m2"][1][1],
    "inertia_z": lambda _, p: p["platform"]["inertia_kg_m2"][2][2],
    "base_radius": lambda a, _: a["base_radius_m"],
    "base_half_angle_deg": lambda a, _: a["base_half_angle_deg"],
    "platform_radius": lambda a, _: a["platform_radius_m"],
    "platform_half_angle_deg": lambda a, _: a["platform_half_angle_deg"],
    "home_height": lambda _, p: p["home"]["position_m"][2],
    "gravity_z": lambda _, p: p["gravity_m_s2"][2],
}
"""Parameters of an FMU that are set where it has them, from the answers and section `platform`."""


def new_configuration(
    answers: dict[str, Any], path: Path, fmu: tuple[Path, Proposal] | None = None
) -> tuple[str, Configuration]:
    """Return the text of a configuration that will stand at `path`, and the configuration that it is.

    fmu: the plant instead of ours, as `recognised` read it. Raises ConfigurationError: what was derived is
    refused.
    """
    sections = _sections(answers, short_name(path))
    comments = dict(_COMMENTS)
    if fmu is not None:
        sections["plant"] = _fmu_plant(answers, sections, *fmu, path.parent)
    elif answers["interface"] != "localcan":
        comments["plant"] = "for `hil sim`; `hil run` drives what is on the bus"
    if counts_itself(answers):
        comments["plant.drives.encoder_resolution_m"] = "0: the frames have steps of their own"
    if answers["inertia_kg_m2"] is not None:
        comments["platform.platform.inertia_kg_m2"] = "about the centre of mass"
    text = yaml_text([schema_line().removeprefix("# "), *_head(path)], sections, comments)
    return text, loads(text, str(path), path.parent)


def _head(path: Path) -> list[str]:
    name = printable(shlex.quote(str(path)))
    return [
        "",
        f"Written by `hil new`. Next: `hil check {name}`, then `hil sim {name}`.",
        "Numbers without a comment, on them or on what they are part of, are answers. The others follow by",
        "the rule beside them, or are usual; replace them as you learn more of your robot. Lengths count",
        "from joint centre to joint centre.",
        "",
    ]


def _sections(a: dict[str, Any], name: str) -> dict[str, Any]:
    home = robot_at_home(a)
    bus = derive.bus_section(a)
    rate = a["rate_Hz"]
    reference = derive.reference_section(a, home)
    w = derive.walked(a, reference, rate)
    approach = lowered(min(0.1 * a["drive_speed_m_s"], 0.25 * a["stroke_m"]))
    limits = derive.limits_section(a, home, w, approach, rate)
    silence = family(a).silence
    reactions = {} if silence == ReactionSettings().silence else {"reactions": {"silence": silence}}
    return {
        "name": name,
        "description": f"{a['mass_kg']:g} kg, {a['mounting']}, six legs of {a['stroke_m']:g} m stroke.",
        "platform": platform_section(a),
        "bus": bus,
        "drives": drives_section(a, rate),
        "loop": {"rate_Hz": rate},
        "controller": derive.controller_section(a, derive.wn_rad_s(rate)),
        "monitor": derive.monitor_section(a, rate),
        "engage": {
            "force_ramp_s": 0.5,
            "brake_release_s": raised(2e-3 * a["brake_ms"]),
            "brake_close_s": derive.closing_s(a, home, limits["speed_m_s"]),
            "approach_speed_m_s": approach,
        },
        "reference": reference,
        "limits": limits,
        "operator": derive.operator_section(a, limits["speed_m_s"]),
        **reactions,
        "recording": {"folder": "runs"},
        "plant": derive.plant_section(a, home),
    }


def recognised(fmu: Path, folder: Path) -> Proposal:
    """Read which variables of an FMU are what.

    folder: where the configuration will stand. Raises PlantError: no FMU; ConfigurationError: no six
    variables that look like force, length and rate, or a name that no configuration can hold.
    """
    if Reader.NON_PRINTABLE.search(_named(fmu, folder)):
        raise ConfigurationError(
            f"{fmu}: its name, or that of its folder, has bytes that are no UTF-8, or signs that steer a "
            "terminal: no configuration can name it; rename it"
        )
    proposal = propose(fmu)
    if proposal.missing:
        raise ConfigurationError(
            f"{fmu}: six variables each are needed for force, length and rate, and none were recognised for "
            f"{', '.join(proposal.missing)}; `hil fmu show {fmu}` lists what there is: name them in "
            "plant.model by hand in a configuration that `hil new` wrote without --fmu"
        )
    return proposal


def _fmu_plant(
    a: dict[str, Any], sections: dict[str, Any], fmu: Path, proposal: Proposal, folder: Path
) -> dict[str, Any]:
    own = sections["plant"]["drives"]
    return {
        "model": _fmu_model(proposal, _named(fmu, folder))
        | derive.step_us(a["rate_Hz"], "step_us", 1000.0)
        | _parameters(proposal, a, sections["platform"]),
        "drives": own | {"force_bandwidth_Hz": derive.LAG_Hz},
    }


def _named(fmu: Path, folder: Path) -> str:
    """Return how a configuration in `folder` names an FMU: by its way from there where it lies below."""
    file = real_path(fmu)
    near = file.is_relative_to(real_path(folder))
    return str(file.relative_to(real_path(folder)) if near else file)


def _fmu_model(proposal: Proposal, path: str) -> dict[str, Any]:
    tool = {"allow_execution_tool": True} if proposal.needs_tool else {}
    units = {"assume_unit": dict(proposal.unstated)} if proposal.unstated else {}
    maps = {key: list(proposal.mapped.get(key, ())) for key in ("force", "length", "rate", "brake")}
    return {"type": "fmu", "path": path, "isolation": "child_process", **tool, **maps, **units}


def _parameters(proposal: Proposal, a: dict[str, Any], platform: dict[str, Any]) -> dict[str, Any]:
    known = {
        name: float(value(a, platform))
        for name, value in FMU_PARAMETERS.items()
        if name in proposal.parameters
    }
    return {"parameters": known} if known else {}


_RATES = ", ".join(f"{rate:g}" for rate in derive.RATES_Hz)
_COMMENTS = {
    "bus.channel": "give the name of yours",
    "bus.bitrate_bit_s": "usual; it has to be that of the drives",
    "bus.data_bitrate_bit_s": "likewise",
    "bus.channels": "each bus by itself has this layout and bit rate; a bus has neighbouring legs",
    "platform.base_joints_m": "three pairs on a circle",
    "platform.platform_joints_m": "three pairs between them; leg 0 ends at 300 deg + half angle",
    "platform.platform.inertia_kg_m2": "ESTIMATE: a thin disc of this mass and the platform's radius",
    "platform.cylinder": f"ESTIMATE: {LOWER_SHARE:.0%} of the leg, a uniform rod of its retracted length",
    "platform.rod": "ESTIMATE: the rest, likewise",
    "platform.gravity_m_s2": "towards the base where the platform stands on it, away from it where it hangs",
    "platform.home.position_m": "all legs at mid-stroke",
    "platform.length_max_m": "retracted length + stroke",
    "loop.rate_Hz": f"by default the highest of {_RATES} that the bus carries",
    "drives.node_ids": "usual; of leg 0 to 5, as they are set in your drives",
    "drives.options.torque_N_m": "what the rated force takes without losses; no more is ever asked for",
    "drives.options.timeout_mode": "servo.timeout_mode 12 of the drives: nothing here reads it back",
    "drives.options.rated_torque_Nm": "0x6076: what the rated force takes without losses; give the drives'",
    "drives.options.velocity": "0x606C in a PDO; `difference` leaves room for 400 Hz",
    "drives.options.model": "its ranges: position, velocity, torque",
    "drives.transmission": "and, as they are: sign, gear_ratio, efficiency, back_driving_efficiency",
    "drives.transmission.lead_m": "leg length a turn of what the drive reports",
    "drives.transmission.counts_per_turn": "0x608F: one count is the encoder's resolution",
    "drives.transmission.offset_m": "where the drive reads zero: mid-stroke",
    "drives.watchdog_ms": "five periods, at least 10",
    "controller.damping_ratio": "critical damping",
    "controller.wn_rad_s": f"delay costs {derive.PHASE_deg:g} deg at the crossover, 2.06 wn",
    "controller": "gains that hold in every pose; `hil compare` on this file shows the other laws",
    "monitor.length_noise_m": "two steps of a reading",
    "monitor.rate_noise_m_s": "what the steps of a rate leave of it, and half of that more",
    "engage.force_ramp_s": "usual: in which force builds up against shut brakes, which tests them",
    "engage.brake_release_s": "twice what the brakes take",
    "engage.brake_close_s": "until the fastest leg rests on its brake, and a fifth of it more",
    "engage.approach_speed_m_s": "a tenth of the drives' speed, a quarter of the stroke a second",
    "reference": "legs stay within 20 % of the stroke about home; a quarter of the drives' speed",
    "reference.duration_s": "three periods of z, at least 10 s",
    "reference.ramp_s": f"{derive.FADE:g} of a period of z, at least 2 s",
    "reference.components": "along z, half as often along x, 0.7 times as often about y",
    "limits.force_N": "2.5 times what the path needs, at most the rated force",
    "limits.force_step_N": "a fifth of it in a tick",
    "limits.force_window_N": "within 250 ms",
    "limits.speed_m_s": "2.5 times what path and approach need",
    "limits.deceleration_m_s2": "half of what is left of the force, on what the legs feel",
    "limits.stroke_margin_m": "2 % of the stroke",
    "limits.following_error_m": "2 % of the stroke",
    "limits.following_error_s": "usual: what the loop may lag behind a leg that moves",
    "reactions.silence": "what these drives do by themselves",
    "limits.standstill_m": "1 % of the stroke, at most 0.5 mm; no less than four steps of a reading",
    "operator": "at which a jog moves platform and legs, at most 80 % of limits.speed_m_s",
    "plant.model.force_bandwidth_Hz": "current loops of servo drives close at some hundred Hz",
    "plant.drives.force_bandwidth_Hz": "current loops of servo drives close at some hundred Hz",
    "plant.drives.damping_N_s_m": "2 m w, w = 2 pi 5 Hz: what a drive does by itself, if told to",
    "plant.drives.hold_stiffness_N_m": "m w^2",
    "plant.model.internal_step_us": "a whole part of the period",
    "plant.model.step_us": "a whole part of the period",
    "plant.model.allow_execution_tool": "it says that it needs the tool that made it",
    "plant.model.assume_unit": "the FMU states none: make sure",
    "plant.model.parameters": "of the answers and section platform",
    "plant.model.brake": "1 holds the leg; empty: it falls",
}
