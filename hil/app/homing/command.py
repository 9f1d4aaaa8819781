"""`hil homing`: shows or sets the leg lengths stored for motors without absolute encoders."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any

from drivers.can.runtime_folder import RoleLock
from drivers.errors import ConfigurationError, RunError
from drivers.signals import LEGS
from hil.app.configuration.configuration import Configuration
from hil.app.homing.file import homing_file, homing_path, read_homing, refuse_moved, write_homing
from hil.app.homing.last_pose import home_lengths


def state_homing(
    c: Configuration,
    *,
    emulated: bool = False,
    at_home: bool = False,
    lengths_m: Sequence[float] | None = None,
    legs_m: Mapping[int, float] | None = None,
) -> dict[str, Any]:
    """Write the given lengths to the homing file, or without any show the file; return the summary.

    emulated: the file of the emulated drives. at_home: the lengths at platform.home. lengths_m: six lengths,
    m. legs_m: single legs by number, m; the others keep the lengths in the file. Raises ConfigurationError:
    no homing file, a length outside the stroke, or a run in progress.
    """
    path = homing_path(c, emulated=emulated)
    if path is None:
        raise ConfigurationError(f"{c.source}: plant.homing_file: missing, needed for --emulated")
    legs, by_hand, given = dict(legs_m or {}), list(range(LEGS)), list(lengths_m or ())
    if at_home:
        given = home_lengths(c).tolist()
    elif legs and not given:
        file = read_homing(c, path)
        if len(legs) < LEGS:
            refuse_moved(c, path, file)
        given = list(file.lengths_m)
        before = [] if file.state == "parked" else file.stated_legs
        by_hand = by_hand if before is None else sorted({*before, *legs})
    if given:
        for leg, length in legs.items():
            given[leg] = length
        low, high = c.platform.length_min_m, c.platform.length_max_m
        wrong = [f"leg {leg}: {q:g} m" for leg, q in enumerate(given) if not low <= q <= high]
        if wrong:
            raise ConfigurationError(
                f"{'; '.join(wrong)}: outside the stroke, allowed: {low:g} to {high:g} m"
            )
        with ExitStack() as stack:
            try:
                for bus in c.bus.buses:
                    lock = RoleLock(bus.interface, str(bus.channel), "controller")
                    stack.callback(lock.close)
            except RunError as error:
                why = f"is not written while a run may move the legs: {error}"
                raise ConfigurationError(f"{path}: {why}") from None
            write_homing(c, path, homing_file(c, "stated", given, None, by_hand))
    file = read_homing(c, path)
    return {
        "success": True,
        "kind": "homing",
        "file": str(path),
        "state": file.state,
        "date": file.date,
        "lengths_m": ", ".join(f"{q:.6f}" for q in file.lengths_m),
        "motor_turns": "not read" if file.turns is None else ", ".join(f"{n:.4f}" for n in file.turns),
    }
