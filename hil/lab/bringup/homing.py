"""A bring-up and the homing file of drives that forget their turns: as in a run, no old length stays."""

from collections.abc import Callable

from hil.app.configuration.configuration import Configuration
from hil.app.homing.file import homing_file, homing_path, read_homing, write_homing
from hil.lab.bringup.context import Context


def mark_moved(c: Configuration, say: Callable[[str], None]) -> None:
    """Mark the file before legs are moved by hand; where there is none there is nothing to mark.

    Raises ConfigurationError for a file that is no homing file of this robot, or cannot be written.
    """
    path = None if c.drives.homing is None else homing_path(c, emulated=False)
    if path is None or not path.exists():
        return
    file = read_homing(c, path)
    write_homing(c, path, homing_file(c, "moved", file.lengths_m, file.turns))
    say(f"{path}: marked as moved, since legs are moved by hand; it is written anew once the platform hangs")


def state_lengths(found: Configuration, context: Context, say: Callable[[str], None]) -> None:
    """Write the lengths of the last known pose, at which the platform was fixed to its legs.

    Raises ConfigurationError where the file cannot be written.
    """
    path = None if found.drives.homing is None else homing_path(found, emulated=False)
    if path is not None:
        lengths = context.machine.pose_lengths[-1].tolist()
        write_homing(found, path, homing_file(found, "stated", lengths, None))
        say(f"{path}: says that the platform hangs at the last known pose")
