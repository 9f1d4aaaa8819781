"""What `hil check` says of the bus time, bus by bus."""

from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.can.python_can import unknown_interface
from drivers.frame_array import sent_frames
from hil.app.check.findings import Report
from hil.app.compose import build_protocol, drive_setup
from hil.app.configuration.bus_budget import bus_budgets, bus_names, set_up_ns
from hil.app.configuration.configuration import Configuration


def report_bus(report: Report, c: Configuration) -> None:
    """Add the arithmetic of each bus, and a warning where the feedbacks come after the window."""
    buses, names = c.bus.buses, bus_names(c.bus)
    titles = [
        f"bus {each.interface} {name}, layout {c.bus.layout}" for each, name in zip(buses, names, strict=True)
    ]
    report.warnings += filter(None, map(unknown_interface, sorted({each.interface for each in buses})))
    budgets = bus_budgets(c.bus, c.drives, c.sensors, c.loop.rate_Hz)
    if not budgets:
        report.sections[titles[0]] = ["no bus time: exists only in lockstep (hil sim)"]
        return
    feedback_us = [1e-3 * ns for ns in answered_ns(c)]
    set_up_us = [1e-3 * ns for ns in set_up_ns(c.bus, build_protocol(c))]
    window_us = c.loop.window_s(c.loop.rate_Hz) * 1e6
    figures = []
    rows = zip(titles, budgets, feedback_us, set_up_us, strict=True)
    for title, budget, answered_us, more_us in rows:
        lines = budget.table().splitlines()
        lines.append(f"  highest rate at {budget.max_load_percent:g} %: {budget.allowed_rate_Hz:.0f} Hz")
        lines.append(f"  SYNC to last feedback {answered_us:.0f} us of a window of {window_us:.0f} us")
        if more_us:
            filled = 1e-4 * c.loop.rate_Hz * (1e-3 * budget.total_ns + more_us)
            waits = "" if filled <= 100.0 else "; the rest waits for the next tick"
            lines.append(
                f"  set-up of the drives, on shut brakes: {more_us:.0f} us more, {filled:.1f} % in all{waits}"
            )
        report.sections[title] = [line.removeprefix("  ") for line in lines]
        figures.append(
            {
                "load_percent": budget.load_percent,
                "total_us": budget.total_ns / 1e3,
                "allowed_rate_Hz": budget.allowed_rate_Hz,
                "feedback_us": answered_us,
                "set_up_us": more_us,
            }
        )
    report.figures["bus"] = max(figures, key=lambda each: each["load_percent"])
    if c.bus.channels:
        by_channel = {each.channel: own for each, own in zip(buses, figures, strict=True)}
        report.figures["bus"] = report.figures["bus"] | {"channels": by_channel}
    _window(report, max(feedback_us), window_us)


def answered_ns(c: Configuration) -> list[int]:
    """Return the bus time of SYNC or polls and the feedbacks, bus by bus, ns."""
    protocol = build_protocol(c)
    traits = protocol.traits
    opening = sent_frames(protocol.controller_end(drive_setup(c, c.loop.rate_Hz)).begin(0))
    opens = {frame.id for frame in opening}
    counted = [frame for frame in traits.sent if frame.id in opens] + [*traits.feedbacks]
    if traits.unasked_s > 0.0:  # one that its drive sends by a timer may stand before the last answer
        asked = {(frame.id, frame.flags) for frame in opening}
        answers = {frame.bus: frame for frame in counted if (frame.id, frame.flags) not in asked}
        counted += answers.values()
    return [
        sum(frame_time_ns(len(f.data), f.flags, BitTiming.of(each)) for f in counted if f.bus == index)
        for index, each in enumerate(c.bus.buses)
    ]


def _window(report: Report, feedback_us: float, window_us: float) -> None:
    if feedback_us > window_us:
        report.warnings.append(
            f"SYNC and six feedbacks take {feedback_us:.0f} us of bus time and the window is "
            f"{window_us:.0f} us (loop.feedback_window_us): legs will be stale"
        )
