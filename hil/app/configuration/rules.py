"""Rules between sections of a configuration, which no section can check alone.

A rule receives the sections that are valid by themselves, see `hil.app.configuration.bounds`. Only rules that
receive a folder read other files.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from math import ceil, inf
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from drivers import build_protocol
from drivers.can.hardware_stamps import HARDWARE_STAMPS
from drivers.errors import ConfigurationError, HilError
from drivers.sensing.dbc import refers
from drivers.sensors import KINDS
from drivers.signals import Reaction
from hil.app.configuration.bounds import (
    MOST_STEPS,
    Finding,
    Folder,
    MissingSectionError,
    Sections,
    bounds,
    exclusions,
    step_key,
)
from hil.app.configuration.bus_budget import bus_budgets
from hil.app.configuration.controller_file import unusable
from hil.app.configuration.fault_rules import force_not_carried, unknown_bus, without_effect
from hil.app.configuration.feedforward_file import learned_forces
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.configuration.problems import split_unit
from hil.app.configuration.yaml_positions import Path
from hil.config.platform import LegBodySettings, PlatformSettings, RigidBodySettings
from hil.config.reference import LiveReference, SampledReference
from hil.design.stability.monitor import certified_law
from hil.robot.geometry import GeometryError
from hil.robot.kinematics import leg_lengths
from hil.trajectory.build import build_trajectory
from plant_fmu.config import FmuPlant


def broken(sections: Mapping[str, Any], folder: Folder) -> Iterator[Finding]:
    """Yield (path, message) of each rule that the sections of a configuration break."""
    c = Sections(**sections)
    for rule in RULES:
        with suppress(MissingSectionError):
            yield from rule(c, folder)


def bit_rates(c: Sections, _: Folder) -> Iterator[Finding]:
    """Check the bit rates against ISO 11898-1: arbitration up to 1 Mbit/s, data phase not slower."""
    for n, each in enumerate(c.bus.buses):
        where: Path = ("bus", "channels", n) if c.bus.channels else ("bus",)
        if each.bitrate_bit_s > 1_000_000:
            fast = f"too fast for arbitration, allowed: at most 1000000, given: {each.bitrate_bit_s}"
            yield (*where, "bitrate_bit_s"), fast
        if each.layout == "fd" and each.data_bitrate_bit_s < each.bitrate_bit_s:
            slow = f"slower than arbitration, bus.bitrate_bit_s, allowed: at least {each.bitrate_bit_s}"
            yield (*where, "data_bitrate_bit_s"), f"{slow}, given: {each.data_bitrate_bit_s}"


def hardware_stamps(c: Sections, _: Folder) -> Iterator[Finding]:
    """Refuse estimated times on a bus with legs: the loop decides by arrival whether feedback is in time."""
    for n, (each, legs) in enumerate(zip(c.bus.buses, c.bus.legs, strict=True)):
        if legs and each.options.get(HARDWARE_STAMPS):
            own = bool(c.bus.channels) and c.bus.channels[n].options is not None
            where: Path = ("bus", "channels", n) if own else ("bus",)
            text = "not for drives, allowed: on a bus of sensors, an entry of bus.channels without legs"
            yield (*where, "options", HARDWARE_STAMPS), text


def _keyed(error: HilError, sections: str, key: Path) -> Finding:
    """(key, rest) of an error that begins with a key in one of these sections; else (`key`, whole error)."""
    named = re.fullmatch(rf"((?:{sections})[\w.\[\]]*): (.*)", str(error), re.DOTALL)
    if named is None:
        return key, str(error)
    return tuple(int(w) if w.isdigit() else w for w in re.findall(r"\w+", named[1])), named[2]


def bus_load(c: Sections, folder: Folder) -> Iterator[Finding]:
    """Check that protocol and sensors support the settings, and that the frames fit into the period."""
    roles = [settings.device for _, settings in c.sensors if settings is not None]
    if folder is None and (refers(c.drives) or any(hasattr(device, "file") for device in roles)):
        return
    try:
        bus_budgets(c.bus, c.drives, c.sensors, c.loop.rate_Hz, folder)
    except HilError as error:
        yield _keyed(error, "bus|drives|sensors", ("bus",))


def node_numbers(c: Sections, _: Folder) -> Iterator[Finding]:
    """Check that no sensor has the node number of a drive or of another sensor."""
    taken = dict.fromkeys(c.drives.node_ids, "drives.node_ids")
    for kind in KINDS:
        settings = getattr(c.sensors, kind)
        if settings is None or not settings.device.has_node:
            continue
        key = "node_ids" if len(settings.nodes) > 1 else "node_id"
        for number in settings.nodes:
            if number in taken:
                yield (
                    ("sensors", kind, key),
                    f"{number} is also in {taken[number]}, allowed: an unused number",
                )
            taken.setdefault(number, f"sensors.{kind}.{key}")


def geometry(c: Sections, _: Folder) -> Iterator[Finding]:
    """Check that a rigid robot can have these joints, masses and inertias."""
    try:
        build_platform(c.platform)
    except GeometryError as error:
        first = error.where.split(",")[0]
        path = ("platform", *(int(w) if w.isdigit() else KEYS.get(w, w) for w in first.split(".")))
        yield path, str(error).removeprefix(f"{error.where}: ")


KEYS = {
    split_unit(key)[0]: key
    for section in (PlatformSettings, RigidBodySettings, LegBodySettings)
    for key in section.model_fields
}
"""Names of `hil.robot.geometry` -> keys of the configuration."""


def reachable_poses(c: Sections, _: Folder) -> Iterator[Finding]:
    """Check that the legs reach home and the poses of the reference; `hil check` covers the path between."""
    low = c.platform.length_min_m + c.limits.stroke_margin_m
    high = c.platform.length_max_m - c.limits.stroke_margin_m
    if low >= high:
        return
    try:
        robot = build_platform(c.platform)
    except HilError:  # the rule on geometry reports it
        return
    poses: dict[Path, Any] = {("platform", "home"): c.platform.home}
    with suppress(MissingSectionError):
        poses |= {("reference", key): getattr(c.reference, key, None) for key in ("pose", "centre", "start")}
        points = enumerate(getattr(c.reference, "points", ()))
        poses |= {("reference", "points", k): point for k, point in points}
    for path, pose in poses.items():
        if pose is not None:
            q = leg_lengths(robot, *pose_arrays(pose))
            legs = ", ".join(f"leg {i} {q[i]:.4f}" for i in np.flatnonzero((q < low) | (q > high)))
            reach = f"out of reach, allowed leg lengths: {low:g} to {high:g} m (soft ends), given: "
            if legs:
                yield path, f"{reach}{legs} m"


def reference_path(c: Sections, folder: Folder) -> Iterator[Finding]:
    """Check the reference: times increase, a repeated path does not jump, the CSV file is valid."""
    sampled = isinstance(c.reference, SampledReference)
    if sampled and folder is None:
        return
    try:
        build_trajectory(c.reference, c.platform.home, folder or FilePath())
    except ConfigurationError as error:
        yield _keyed(error, "reference", ("reference", "path") if sampled else ("reference",))


def designed_controllers(c: Sections, folder: Folder) -> Iterator[Finding]:
    """Check that the loop can run the controllers from files, including those of `compare.laws`."""
    laws = {("controller",): c.controller} | {
        ("compare", "laws", k): law for k, law in c.compare.laws.items()
    }
    for path, law in laws.items():
        trouble = None if folder is None else unusable(law, c.loop.rate_Hz, folder)
        if trouble is not None:
            yield (*path, "controller_file"), trouble


def certificate(c: Sections, _: Folder) -> Iterator[Finding]:
    """Check that the law has a Lyapunov certificate if the monitor acts on it."""
    return certified_law(c.monitor, c.controller, None)


def whole_steps(c: Sections, _: Folder) -> Iterator[Finding]:
    """Check that the loop's period is a whole number of the plant's steps."""
    if c.plant is None:
        return
    key, period_us = step_key(c.plant), 1e6 / c.loop.rate_Hz
    step_us: float = getattr(c.plant.model, key)
    steps = period_us / step_us
    if steps <= MOST_STEPS and (steps < 0.5 or abs(steps - round(steps)) > 1e-9 * steps):
        parts = f"allowed: {period_us:g} us (loop.rate_Hz) divided by a whole number"
        given = f"as {period_us / ceil(steps):.12g}, given: {step_us:g}"
        yield ("plant", "model", key), f"the period is not a whole number of steps, {parts}, {given}"


def fmu_file(c: Sections, folder: Folder) -> Iterator[Finding]:
    """Check that the FMU file of the plant exists."""
    if c.plant is not None and isinstance(c.plant.model, FmuPlant) and folder is not None:
        path = folder / c.plant.model.path
        if not path.is_file():
            yield ("plant", "model", "path"), f"no such file, given: {c.plant.model.path} (looked for {path})"


def faults(c: Sections, _: Folder) -> Iterator[Finding]:
    """Check that faults have an effect at the plant, an existing bus, and a force that a frame carries."""
    if c.plant is None:
        return
    for n, fault in enumerate(c.plant.faults):
        found = {"kind": without_effect(c.plant, str(fault.kind))}
        with suppress(MissingSectionError):
            found["bus"] = unknown_bus(fault, c.bus)
            found["force_N"] = force_not_carried(fault, c.bus, c.drives)
        for key, message in found.items():
            if message:
                yield ("plant", "faults", n, key), message


def drives(c: Sections, _: Folder) -> Iterator[Finding]:
    """Check that the drives have the reaction to silence and that their position field covers the stroke."""
    try:
        traits = build_protocol(c.bus, c.drives).traits
    except HilError:  # the rule on the bus load reports it
        return
    if Reaction[c.reactions.silence.upper()] not in traits.reactions:
        allowed = f"allowed: {', '.join(each.name.lower() for each in traits.reactions)}"
        what = f"no reaction of these drives (drives.protocol {c.drives.protocol} and its options)"
        yield ("reactions", "silence"), f"{what}, {allowed}, given: {c.reactions.silence}"
    low, high = traits.reported_lengths or (np.array([-inf]), np.array([inf]))
    beyond = np.flatnonzero((low > c.platform.length_min_m) | (high < c.platform.length_max_m))
    for leg in beyond[:1].tolist():
        ends = f"the position that drive {leg} reports ends at {low[leg]:.4g} and {high[leg]:.4g} m"
        allowed = f"allowed: beyond the leg's {c.platform.length_min_m:g} to {c.platform.length_max_m:g} m"
        yield ("drives", "transmission"), f"{ends}, {allowed}; change offset_m, gear_ratio, lead or range"


def data_sheet(c: Sections, folder: Folder) -> Iterator[Finding]:
    """Check that the CiA 402 drives' data sheet (EDS) has every object that the controller needs.

    The file is searched in the current folder, then next to the configuration; not for a configuration in a
    log.
    """
    options = c.drives.options
    if folder is None or c.drives.protocol != "cia402" or "eds" not in options:
        return
    from drivers.cia402.eds import check_eds  # noqa: PLC0415 - for such drives only
    from drivers.cia402.objects import HAS  # noqa: PLC0415

    here, there = FilePath(str(options["eds"])), folder / str(options["eds"])
    sheet = there if there.is_file() and not here.is_file() else here
    try:
        may_lack = {key for name, key in HAS.items() if options.get(name) is False}
        check_eds(str(sheet), velocity=options.get("velocity", "pdo") == "pdo", may_lack=may_lack)
    except ConfigurationError as error:
        yield _keyed(error, "drives", ("drives", "options", "eds"))


def usable_feedforward(c: Sections, folder: Folder) -> Iterator[Finding]:
    """Check that the feed-forward was learned on this reference, controller and platform."""
    if folder is not None and not isinstance(c.reference, LiveReference):
        try:
            learned_forces(c.feedforward, c.reference, c.controller, c.platform, folder)
        except ConfigurationError as error:
            yield ("feedforward", "file"), str(error)


RULES: tuple[Callable[[Sections, Folder], Iterator[Finding]], ...] = (
    bounds, exclusions, bit_rates, hardware_stamps, bus_load, node_numbers, geometry, reachable_poses,
    reference_path, designed_controllers, certificate, whole_steps, fmu_file, faults, drives, data_sheet,
    usable_feedforward,
)  # fmt: skip
