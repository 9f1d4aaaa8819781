"""The last step of a rehearsal: all six legs under the ordinary controller, at reduced limits."""

from typing import NamedTuple

from hil.app.compose import build_cycle
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform
from hil.app.configuration.unattended import unattended
from hil.app.homing.last_pose import last_pose_of
from hil.app.sim.build import build_lockstep
from hil.lab.bringup.machine import known_poses
from hil.lab.bringup.rehearsal import emulated, mounted
from hil.loop.run_end import Ending
from hil.robot.kinematics import leg_lengths
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
    """Run the first motion of a found configuration in lockstep; return how it ended.

    Its brake tests carry the platform's weight on all six brakes before they open and after they have shut.
    Raises PlantError.
    """
    c = unattended(c)
    pose = last_pose_of(c, None)
    if pose is not None:
        pose = pose._replace(length=leg_lengths(build_platform(c.platform), *known_poses(c)[0]))
    cycle = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms, last_pose=pose)
    plant = mounted(c, bench.wiring)
    try:
        cables = bench.behind_cables(plant)
        nodes = WiredNodes(bench.wiring, cables, bench.protocol, emulated(c).drives, c.drives)
        lockstep = build_lockstep(c, cycle, nodes)
        return lockstep.run(None, lambda *_: None)
    finally:
        plant.close()


def lines_of(success: bool, *words: str) -> list[str]:
    """Return how the six legs ran, as lines of the checklist; `words`: what else is said, some empty."""
    mark = "x" if success else "!"
    done = "brakes carried the platform, first motion done, parked" if success else "ended early"
    figures = ": ".join(filter(None, (done, "; ".join(filter(None, words)))))
    return [f"[{mark}] together: six legs at reduced limits", f"      {figures}"]
