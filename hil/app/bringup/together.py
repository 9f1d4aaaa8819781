"""The last step of a rehearsal: all six legs under the ordinary controller, at reduced limits."""

from drivers.signals import Mode
from hil.app.bringup.rehearsal import mounted_nodes
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import Configuration
from hil.app.sim.lockstep import build_lockstep
from hil.loop.run_end import Ending
from plant_fmu.rehearsal.bench import RehearsalBench


def six_legs(c: Configuration, bench: RehearsalBench) -> Ending:
    """Run the first motion of a found configuration in lockstep; return how it ended.

    Its brake tests carry the platform's weight on all six brakes before they open and after they have shut.
    Raises PlantError.
    """
    cycle = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)
    nodes, plant = mounted_nodes(c, bench)
    try:
        lockstep = build_lockstep(c, cycle, nodes)
        return lockstep.run(None, lambda *_: None)
    finally:
        plant.close()


def lines_of(ending: Ending) -> list[str]:
    """Return how the six legs ran, as lines of the checklist."""
    done = ending.mode is Mode.PARKED and ending.success
    mark = "x" if done else "!"
    figures = "brakes carried the platform, first motion done, parked" if done else ending.trouble
    return [f"[{mark}] together: six legs at reduced limits", f"      {figures}"]
