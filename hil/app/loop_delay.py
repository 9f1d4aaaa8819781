"""Delay of the loop from encoder sample to leg force, derived from the configuration."""

from math import pi
from typing import NamedTuple

from drivers import build_protocol
from hil.app.configuration.configuration import Configuration
from hil.config.delay import ForceDelay
from hil.control.feedforward_pd import FeedforwardPDSettings
from hil.design.stability.observed_loop import Observer
from plant_fmu.config import StewartPlant


class LoopDelay(NamedTuple):
    """Delays, s, from the encoder sample to the force in the legs."""

    period_s: float
    transport_s: float
    """Pure delay from SYNC through feedback and computation to the drives' receipt of the command."""
    lag_s: float
    """Time constant of the drives' first-order force loop; 0: unknown."""

    @property
    def total_s(self) -> float:
        """Delay of the loop at low frequency, s: transport, lag, and half a period of the zero-order hold."""
        return self.transport_s + self.lag_s + 0.5 * self.period_s


def loop_delay(c: Configuration) -> LoopDelay:
    """Delay of the loop, as stated in `delay_compensation` or `estimation.wrench`, else an upper bound.

    Transport is at most one period, none in layout `ideal`, and one more where the poll of the next tick
    carries the command. A reading that a timer sends is up to a period of the timer old. The lag is that of
    our own FMU, else of the emulated drives. In layout `ideal` the stated values are ignored.
    """
    period = 1.0 / c.loop.rate_Hz
    ideal = c.bus.layout == "ideal"
    stated = stated_delay(c)
    bandwidth_Hz = 0.0
    if c.plant is not None:
        drives = c.plant.model if isinstance(c.plant.model, StewartPlant) else c.plant.drives
        bandwidth_Hz = drives.force_bandwidth_Hz
    lag = 1.0 / (2.0 * pi * bandwidth_Hz) if bandwidth_Hz > 0.0 else 0.0
    traits = build_protocol(c.bus, c.drives).traits
    transport = (traits.command_delay_ticks + (not ideal)) * period + traits.unasked_s * traits.timed
    if stated is not None and not ideal:
        transport = 1e-3 * stated.bus_ms if "bus_ms" in stated.model_fields_set else transport
        lag = 1e-3 * stated.drive_lag_ms if "drive_lag_ms" in stated.model_fields_set else lag
    return LoopDelay(period, transport, lag)


def stated_delay(c: Configuration) -> ForceDelay | None:
    """Section that states the delay of the forces, `delay_compensation` or `estimation.wrench`; else None."""
    w = c.estimation.wrench
    observes = observer_of(c) is not None and not {"bus_ms", "drive_lag_ms"}.isdisjoint(w.model_fields_set)
    return c.controller.lookahead or (w if observes else None)


def observer_of(c: Configuration) -> Observer | None:
    """Observer of the wrench in the loop; None without one, or if the law ignores its estimate."""
    w, law = c.estimation.wrench, c.controller
    online = isinstance(law, FeedforwardPDSettings) and law.evaluation == "online"
    if w.source != "observer" or not (online or (law.axes is not None and law.compensates_wrench)):
        return None
    return Observer(w.bandwidth_Hz, 1e-3 * w.bus_ms, 1e-3 * w.drive_lag_ms)


def unlike_law(c: Configuration) -> bool:
    """True if the wrench observer and the law that compensates its estimate have different models."""
    w, law = c.estimation.wrench, c.controller
    believed = law.believed
    return observer_of(c) is not None and None not in (w.model, believed) and w.model != believed
