"""Budget of a CAN adapter: what its latency, loss and queue cost the ticks of a configuration."""

from typing import NamedTuple

from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.frame_array import sent_frames
from drivers.signals import LEGS
from hil.app.adapter.file import Qualification
from hil.app.compose import build_protocol, drive_setup
from hil.app.configuration.bus_budget import bus_budgets
from hil.app.configuration.configuration import Configuration

SELDOM_s = 1000 * 3600.0
"""A fault by lost frames that comes less often than this is not worth a warning."""


class Judgement(NamedTuple):
    """What speaks against an adapter, one sentence each."""

    answer_us: float
    """Longest time from SYNC to the last feedback: bus time and the adapter's longest latency."""
    refused: str
    """Reason why no tick can work; empty if none."""
    warnings: list[str]


def answered_ns(c: Configuration) -> list[int]:
    """Bus time, ns, of SYNC or polls and the feedback frames, one value for each bus."""
    protocol = build_protocol(c)
    traits = protocol.traits
    opening = sent_frames(protocol.controller_end(drive_setup(c, c.loop.rate_Hz)).begin(0))
    opens = {frame.id for frame in opening}
    counted = [frame for frame in traits.sent if frame.id in opens] + [*traits.feedbacks]
    if traits.unasked_s > 0.0:  # a frame that a drive sends by a timer may delay the last answer
        asked = {(frame.id, frame.flags) for frame in opening}
        answers = {frame.bus: frame for frame in counted if (frame.id, frame.flags) not in asked}
        counted += answers.values()
    return [
        sum(frame_time_ns(len(f.data), f.flags, BitTiming.of(each)) for f in counted if f.bus == index)
        for index, each in enumerate(c.bus.buses)
    ]


def stale_every_s(c: Configuration, loss: float) -> float:
    """Mean time, s, between faults STALE by lost frames alone; loss: share of lost frames.

    A leg misses a tick where its SYNC (or poll) or its feedback is lost, m = 1 - (1 - loss)^2. The fault
    needs stale_fault_ticks = k such ticks in a row: at most 6 m^k a tick.
    """
    missed = 1.0 - (1.0 - loss) ** 2
    return float("inf") if loss == 0.0 else 1.0 / (LEGS * missed**c.limits.stale_fault_ticks * c.loop.rate_Hz)


def judge(c: Configuration, index: int, q: Qualification) -> Judgement:
    """Adapter of bus `index` under the frames of a tick, the feedback window and the limits.

    One exchange passes the adapter twice: SYNC or poll out, feedback in. So does the measured frame, from
    the call that sends it to its reception; hence one latency is added to the bus time.
    """
    name, wire_us, window_us = q.channel, 1e-3 * answered_ns(c)[index], 1e6 * c.loop.window_s(c.loop.rate_Hz)
    answer_us, refused, found = wire_us + q.worst_us, "", []
    frames = bus_budgets(c.bus, c.drives, c.sensors, c.loop.rate_Hz, c.folder)[index].frames.total()
    arithmetic = f"{wire_us:.0f} us of bus time and {{:.0f}} us of latency are {{:.0f}} us"
    if wire_us + q.latency_us > window_us:
        total = arithmetic.format(q.latency_us, wire_us + q.latency_us)
        refused = (
            f"{name} is too slow: from SYNC to the last feedback {total} in half of all ticks, and "
            f"the window has {window_us:.0f} us; lower loop.rate_Hz, or measure another adapter"
        )
    elif answer_us > window_us:
        found.append(
            f"{name} is late at times: from SYNC to the last feedback "
            f"{arithmetic.format(q.worst_us, answer_us)} at worst, and the window has {window_us:.0f} us; "
            "such a tick goes without it; lower loop.rate_Hz, or lengthen loop.feedback_window_us"
        )
    if q.lost:
        every_s, ticks = stale_every_s(c, q.loss), c.limits.stale_fault_ticks
        often = f"; that is a fault STALE every {every_s / 60:.3g} min" if every_s < SELDOM_s else ""
        found.append(
            f"{name} loses {q.loss:.2%} of the frames, and CAN itself loses none{often} "
            f"(limits.stale_fault_ticks {ticks}); use another adapter, or more than one bus"
        )
    if q.unsent or (q.queue_filled and q.queue < frames):
        found.append(
            f"{name} accepts {q.queue} frames at once, and a tick has {frames}; {q.unsent} were refused at "
            f"{q.rate_Hz:g} Hz: 'ip link set {name} txqueuelen {max(32, 2 * frames)}'"
        )
    if q.fd == "failed":
        found.append(
            f"{name} does not pass CAN FD with bit-rate switch: set dbitrate and 'fd on', see bus.layout"
        )
    return Judgement(answer_us, refused, found)
