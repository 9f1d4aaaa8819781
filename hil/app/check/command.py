"""`hil check CONFIG`: prints figures and warnings about a configuration before anything moves."""

from collections.abc import Callable

from hil.app.check import figures, plant, sensing
from hil.app.check.report import Report
from hil.app.check.subject import controlled_stop_m, course, looked_at, reacted_to
from hil.app.check.warnings import warnings
from hil.app.configuration.configuration import Configuration

SECTIONS: tuple[Callable[[Report], None], ...] = (
    figures.robot, figures.bus, figures.drives, figures.transmission, figures.controller, figures.stability,
    sensing.monitor, sensing.encoders, sensing.fusion, figures.reference, figures.operating, figures.payload,
    figures.feedforward, plant.plant, figures.permissions,
)  # fmt: skip


def inspect(c: Configuration, tell: Callable[[float, float], None] = lambda *_: None) -> Report:
    """Report of `hil check` on a configuration and its whole reference.

    tell: progress callback, called with checked and total seconds of the reference. Raises
    ConfigurationError: each limit that the reference violates, with the first instant; PlantError: an FMU
    that cannot be hosted.
    """
    report = Report(looked_at(c, tell))
    for section in SECTIONS:
        section(report)
    for code, text in warnings(report.s):
        report.codes.append(code)
        report.warnings.append(text)
    return report


def refuse_unreachable(c: Configuration) -> None:
    """Refuse a reference that violates a limit anywhere on its path; takes up to half a second.

    Raises ConfigurationError with the first instant of each violated limit.
    """
    course(c)


def stopping_distances_m(c: Configuration) -> tuple[float, float]:
    """Longest leg travels on the reference, m: after silence until the brake holds; in a controlled stop.

    Silence: commands no longer reach the drives. Drives whose watchdog this program does not set have no
    bound; a reaction within `drives.watchdog_ms` is assumed then. Raises ConfigurationError as `inspect`.
    """
    *_, w = course(c)
    return reacted_to(c, w).travel_m(w), controlled_stop_m(c, w)
