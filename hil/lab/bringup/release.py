"""The end of a bring-up: all six legs under the ordinary controller, and the homing file."""

from collections.abc import Callable
from contextlib import closing
from typing import NamedTuple

from hil.app.compose import build_cycle
from hil.app.configuration.changes import unattended
from hil.app.configuration.configuration import Configuration
from hil.app.homing.file import homing_file, homing_path, read_homing, write_homing
from hil.app.homing.last_pose import home_lengths, last_pose_of
from hil.app.sim.build import build_lockstep
from hil.lab.bringup.context import Context
from hil.lab.bringup.rehearsal import emulated, mounted
from hil.loop.run_end import Ending
from plant_fmu.rehearsal.bench import RehearsalBench
from plant_fmu.rehearsal.wired_drives import WiredNodes


class Together(NamedTuple):
    """How the six legs ran."""

    success: bool
    lines: list[str]
    """For the checklist."""
    brake_failed: bool = False
    """A brake did not hold, or did not open: the brakes are to be tested again."""


def six_legs(c: Configuration, bench: RehearsalBench) -> Ending:
    """Run the first motion of a found configuration in lockstep, with its brake tests. Raises PlantError."""
    c = unattended(c)
    pose = last_pose_of(c, None)
    pose = None if pose is None else pose._replace(length=home_lengths(c))
    cycle = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms, last_pose=pose)
    with closing(mounted(c, bench.wiring)) as plant:
        cables = bench.behind_cables(plant)
        nodes = WiredNodes(bench.wiring, cables, bench.protocol, emulated(c).drives, c.drives)
        return build_lockstep(c, cycle, nodes).run(None, lambda *_: None)


def lines_of(success: bool, *words: str) -> list[str]:
    """Return how the six legs ran, as lines of the checklist; `words`: what else is said, some empty."""
    done = "brakes carried the platform, first motion done, parked" if success else "ended early"
    figures = "; ".join(filter(None, (done, *words)))
    return [f"[{'x' if success else '!'}] together: six legs at reduced limits", f"      {figures}"]


def mark_moved(c: Configuration, say: Callable[[str], None]) -> None:
    """Mark the homing file, if any, before legs are moved by hand. Raises ConfigurationError."""
    path = None if c.drives.homing is None else homing_path(c, emulated=False)
    if path is None or not path.exists():
        return
    file = read_homing(c, path)
    write_homing(c, path, homing_file(c, "moved", file.lengths_m, file.turns))
    say(f"{path}: marked as moved, since legs are moved by hand; it is written anew once the platform hangs")


def state_lengths(found: Configuration, context: Context, say: Callable[[str], None]) -> None:
    """Write the lengths of the last known pose, where the platform was fixed. Raises ConfigurationError."""
    path = None if found.drives.homing is None else homing_path(found, emulated=False)
    if path is not None:
        lengths = context.machine.pose_lengths[-1].tolist()
        write_homing(found, path, homing_file(found, "stated", lengths, None))
        say(f"{path}: says that the platform hangs at the last known pose")
