"""Builds the lockstep simulation of both ends of the buses from a Configuration."""

from drivers.can.bus_time import BitTiming
from drivers.config import UDP
from drivers.errors import ConfigurationError
from hil.app.configuration.changes import without_operator
from hil.app.configuration.configuration import Configuration
from hil.app.sim.lockstep import Lockstep
from hil.loop.cycle import Cycle
from plant_fmu.drives.nodes import Nodes


def build_lockstep(
    c: Configuration, cycle: Cycle, nodes: Nodes, first: int = 0, *, attended: bool = False
) -> Lockstep:
    """Lockstep simulation on the configured buses, from tick `first` on.

    Frames take no bus time in layout `ideal` and on interface `udp`. attended: an operator gives commands.
    Raises ConfigurationError: without an operator the run would wait forever (see `unattended`).
    """
    if not attended and without_operator(c) is not c:
        raise ConfigurationError(
            f"{c.source}: operator: nobody gives commands here, allowed: without start, deadman_s and stays"
        )
    timed = [c.bus.layout != "ideal" and each.interface != UDP for each in c.bus.buses]
    timings = [BitTiming.of(each) if of else None for each, of in zip(c.bus.buses, timed, strict=True)]
    return Lockstep(cycle, nodes, timings, c.loop.window_s(c.loop.rate_Hz), tick=first - 1)
