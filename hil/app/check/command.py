"""`hil check CONFIG`: what bus, legs and limits say about a configuration before anything moves."""

from collections.abc import Callable

from hil.app.check import figures, sensing
from hil.app.check.report import Report
from hil.app.check.subject import controlled_stop_m, course, looked_at, reacted_to
from hil.app.check.warnings import warnings
from hil.app.configuration.configuration import Configuration

SECTIONS: tuple[Callable[[Report], None], ...] = (
    figures.robot, figures.bus, figures.drives, figures.transmission, figures.controller, figures.stability,
    sensing.monitor, sensing.encoders, sensing.fusion, figures.reference, figures.operating, figures.payload,
    figures.feedforward, figures.plant, figures.permissions,
)  # fmt: skip


def inspect(c: Configuration, tell: Callable[[float, float], None] = lambda *_: None) -> Report:
    """Return the report on a configuration and its whole reference.

    tell: called now and then with the s of the reference that were looked at, and of how many.
    Raises ConfigurationError with the limits that the reference breaks, each with its first instant;
    PlantError for an FMU that cannot be hosted.
    """
    report = Report(looked_at(c, tell))
    for section in SECTIONS:
        section(report)
    for code, text in warnings(report.s):
        report.codes.append(code)
        report.warnings.append(text)
    return report


def refuse_unreachable(c: Configuration) -> None:
    """Refuse a reference that breaks a limit somewhere on its way; costs up to half a second.

    Raises ConfigurationError with the first instant of each limit that it breaks.
    """
    course(c)


def stopping_distances_m(c: Configuration) -> tuple[float, float]:
    """Return how far a leg may travel on the reference, m, as printed.

    From silence until its brake holds it, and in a stop under control. Where the drives have no watchdog that
    is set from here, the first is what a reaction within `drives.watchdog_ms` leaves: theirs has no bound.
    Raises ConfigurationError as `inspect` does.
    """
    *_, w = course(c)
    return reacted_to(c, w).travel_m(w), controlled_stop_m(c, w)
