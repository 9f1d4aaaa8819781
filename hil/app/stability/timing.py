"""Timing of a stability proof: its premises about frames, and the additional delay that a run tolerates."""

from math import inf

from drivers import build_protocol
from hil.app.configuration.bus_budget import bus_budgets
from hil.app.configuration.configuration import Configuration
from hil.app.loop_delay import loop_delay, stated_delay
from hil.app.sim.lockstep import COMPUTE_US
from hil.app.stability.assessment import Assessment


def timed(c: Configuration, found: Assessment) -> Assessment:
    """Result of a proof with its timing added: premises, and the additional delay that a run tolerates."""
    if found.status not in {"proven", "conditional"}:
        return found
    parts = (found.figures.get("worst", {}), found.figures.get("sampled", {}))
    margins = [part["delay_margin_ms"] for part in parts if part.get("delay_margin_ms") is not None]
    values = [one["value"] if isinstance(one, dict) else one for one in margins]
    spare_s, limit = to_spare(c, 1e-3 * min(values, default=inf))
    counted = "old_feedback" in found.figures and "reaching" not in found.figures
    premises = timing(c, counted=counted)
    lines = [f"holds while    {'; '.join(premises)}", *found.lines]
    lines.append(f"delay to spare {1e3 * spare_s:.3g} ms: {limit}")
    figures = found.figures | {"delay_to_spare_ms": 1e3 * spare_s}
    return found._replace(premises=premises, lines=lines, figures=figures)


def timing(c: Configuration, *, counted: bool) -> list[str]:
    """Premises of a proof on frames and limits; counted: the bound includes late feedback without warning."""
    warned, feedback = c.limits.stale_warn_ticks, "feedback arrives in its tick"
    if warned > 1:
        key = f"limits.stale_warn_ticks {warned}"
        feedback += f" ({key} warns later: set 1)"
        if counted:
            feedback = f"feedback is less than {warned} ticks old ({key})"
    carried = "before the next SYNC"
    if build_protocol(c.bus, c.drives).traits.command_delay_ticks:
        carried = "with the poll of the next tick"
    return [feedback, f"every command arrives {carried}", "no tick is late", "no force is limited"]


def to_spare(c: Configuration, margin_s: float) -> tuple[float, str]:
    """(additional delay, s, that a run tolerates; text on what limits it).

    margin_s: delay margin of the linear loop, s; `inf` without one.
    """
    traits, delay = build_protocol(c.bus, c.drives).traits, loop_delay(c)
    T, stale_s = delay.period_s, (c.limits.stale_fault_ticks - 1) * delay.period_s
    rows = [
        (margin_s, "the margin of the loop"),
        (stale_s, f"older feedback faults, limits.stale_fault_ticks {c.limits.stale_fault_ticks}"),
    ]
    if traits.has_watchdog:
        silent_s = 1e-3 * c.drives.watchdog_ms - T
        rows.append((silent_s, f"drives.watchdog_ms {c.drives.watchdog_ms:g} ends a longer gap of commands"))
    if traits.answers_name_sync and c.bus.layout != "ideal":
        until_s = max(0.0, T - (transport_s(c) if stated_delay(c) is None else delay.transport_s))
        rows.append((until_s, "drives refuse commands after the next SYNC"))
    return min(rows)


def transport_s(c: Configuration) -> float:
    """Time from the encoder sample until the drives have the command, s: frames, computing; none if `ideal`.

    Drives whose next poll carries the command sample and receive in one frame: exactly that many periods.
    """
    if c.bus.layout == "ideal":
        return 0.0
    if polls := build_protocol(c.bus, c.drives).traits.command_delay_ticks:
        return polls / c.loop.rate_Hz
    budgets = bus_budgets(c.bus, c.drives, c.sensors, c.loop.rate_Hz, c.folder)
    sent_s = 1e-9 * max(each.total_ns for each in budgets) + 1e-6 * COMPUTE_US
    return min(sent_s, 1.0 / c.loop.rate_Hz)
