"""Rules on what the drives of a family can report and can do by themselves."""

from collections.abc import Iterator
from pathlib import Path as Folder

import numpy as np

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError, HilError
from drivers.family import Family
from drivers.signals import Reaction
from drivers.transmission import forgotten_length
from hil.app.configuration.yaml_positions import Path
from hil.config.platform import PlatformSettings
from hil.config.reactions import ReactionSettings


def _protocol(bus: BusSettings, drives: DriveSettings) -> Family | None:
    """Return the codec; None where its settings are wrong, which the rule on the bus load says."""
    try:
        return build_protocol(bus, drives)
    except HilError:
        return None


def own_reaction(
    bus: BusSettings, drives: DriveSettings, reactions: ReactionSettings, _: object
) -> Iterator[tuple[Path, str]]:
    """Refuse a reaction to silence that the drives do not have."""
    protocol = _protocol(bus, drives)
    if protocol is not None and Reaction[reactions.silence.upper()] not in protocol.traits.reactions:
        allowed = ", ".join(each.name.lower() for each in protocol.traits.reactions)
        message = (
            f"not what these drives do by themselves, allowed with drives.protocol {drives.protocol} and its "
            f"options: {allowed}, given: {reactions.silence}"
        )
        yield ("reactions", "silence"), message


def data_sheet(drives: DriveSettings, folder: Folder | None) -> Iterator[tuple[Path, str]]:
    """Refuse drives whose data sheet lacks an object that we need.

    It is looked for in the present folder, then beside the configuration; not for one that a log holds.
    """
    if folder is None or drives.protocol != "cia402" or "eds" not in drives.options:
        return
    from drivers.cia402.objects import check_eds  # noqa: PLC0415 - with an extra

    name = str(drives.options["eds"])
    here = Folder(name)
    sheet = here if here.is_file() or not (folder / name).is_file() else folder / name
    try:
        check_eds(str(sheet), velocity=drives.options.get("velocity", "pdo") == "pdo")
    except ConfigurationError as error:
        yield ("drives", "options", "eds"), str(error).removeprefix("drives.options.eds: ")


def reported_stroke(
    bus: BusSettings, drives: DriveSettings, platform: PlatformSettings, _: object
) -> Iterator[tuple[Path, str]]:
    """Refuse leg lengths that the drives' position field cannot carry."""
    protocol = _protocol(bus, drives)
    reported = None if protocol is None else protocol.traits.reported_lengths
    if reported is None:
        return
    low, high = reported
    for leg, (least, most) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        if platform.length_min_m < least or platform.length_max_m > most:
            message = (
                f"the position that drive {leg} reports ends at leg lengths of {least:.4g} and {most:.4g} m, "
                f"allowed: platform.length_min_m {platform.length_min_m:g} to length_max_m "
                f"{platform.length_max_m:g} within them; change offset_m, gear_ratio or lead, or the range "
                "of the drive"
            )
            yield ("drives", "transmission"), message
            return


def homing(drives: DriveSettings, _: object) -> Iterator[tuple[Path, str]]:
    """Refuse homing of drives without a motor, and a limit that no leg could exceed."""
    if drives.homing is None:
        return
    if drives.transmission is None:
        message = f"drives.protocol {drives.protocol} speaks of leg lengths, and forgets none; leave it out"
        yield ("drives", "homing"), message
        return
    quarter_m = 0.25 * float(np.min(forgotten_length(drives.transmission, drives.homing.forgotten_turns)))
    if drives.homing.limit_m >= quarter_m:
        message = (
            f"too large to tell one turn from the next, allowed: less than {quarter_m:.4g}, a quarter of the "
            f"leg length that forgotten_turns are, given: {drives.homing.limit_m:g}"
        )
        yield ("drives", "homing", "limit_m"), message
