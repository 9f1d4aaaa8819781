"""`hil adapter`: measures a CAN interface under the frames and the rate of a configuration.

`near` sends and `far` receives: two interfaces of one bus, or two sockets on one interface. All frames have
identifiers of OURS, to which no drive of the configuration listens.
"""

import socket
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.can import netlink
from drivers.can.adapter import echoes, identity, time_stamps
from drivers.can.bus import Bus
from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.can.can_interface import parse
from drivers.can.hardware_stamps import HARDWARE_STAMPS
from drivers.config import BusSettings
from drivers.errors import BusError, ConfigurationError, RunError
from drivers.frame_array import sent_array
from drivers.motors import MotorProtocol
from drivers.protocol import BRS, EXTENDED, FD, Frame
from hil.app.adapter.qualification import VERSION, Qualification, judge, qualification_path
from hil.app.compose import build_protocol
from hil.app.configuration.bus_budget import bus_budgets
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.configuration.section_file import check_section_path, write_section
from hil.app.output import figure_rows
from hil.loop.clock import Deadlines, real_time_rights

BLOCK = range(0x7C0, 0x7E0)
"""Identifiers of 11 bits: no CANopen device listens to them (CiA 301); lower ones go first."""
WIDE = 0x1F00_0000
"""Added for drives with 29 bits: a RobStride has no message type 31, and a moteus has the prefix 0."""
OURS = frozenset(BLOCK) | frozenset(WIDE + each for each in BLOCK)
SINGLES = 1000
"""Frames sent one by one for the latency; if none of the first SILENT arrives, no more are sent."""
SILENT = 50
PATIENCE_NS = 20_000_000
"""Patience with one frame; after it the frame counts as lost."""
BURST = 128
"""Most frames sent at once."""
QUIET_NS = 1_500_000_000
"""Time for which the bus must carry no frames of others before anything is sent."""
_REST_NS = 100_000_000
"""Patience with the last frames of several."""
_DOWN_NS = 3_000_000_000
"""Patience with an interface that was down."""
_REMARK = "measured by `hil adapter`; `hil check` budgets with it, `hil run` compares the adapter"
_UNPRINTED = {"kind", "version", "date", "channel", "layout", "bitrate_bit_s", "data_bitrate_bit_s"}
Tell = Callable[[int], None]
Shape = tuple[int, int]
"""Length and flags of a frame."""


class Loss(NamedTuple):
    """Frames of all ticks, in both directions."""

    sent: int
    lost: int
    refused: int


def frames_of(shapes: Sequence[Shape]) -> Rows:
    """Frames of these lengths, with identifiers of OURS and nothing but zeros."""
    return sent_array(
        Frame(
            BLOCK[k % len(BLOCK)] + (WIDE if flags & EXTENDED else 0),
            bytes(length),
            flags & (FD | BRS | EXTENDED),
        )
        for k, (length, flags) in enumerate(shapes)
    )


def only_ours(received: Rows) -> Rows:
    """Pass frames of OURS. Raises RunError for others: a drive that sends may also listen."""
    strange = [each for each in received["id"].tolist() if each not in OURS]
    if strange:
        raise RunError(
            f"the bus carries frames of others, the first 0x{strange[0]:X}: nothing more is sent, as a drive "
            "may listen; switch the drives off or unplug them, and stop other programs on this bus"
        )
    return received


def require_quiet(near: Bus) -> None:
    """Listen before anything is sent. Raises RunError if others send frames."""
    end = near.clock.now() + QUIET_NS
    while near.clock.now() < end:
        only_ours(near.wait(end))


def latencies_us(near: Bus, far: Bus, timing: BitTiming, tell: Tell, flags: int = 0) -> Array:
    """Latencies (n,) us of single classic frames of 8 bytes, without bus time; n: frames received.

    From before the call that sends to the time stamp of reception. The bus time is the longest of such a
    frame, as in the bus budget: bus time of the budget and latency are together what was measured.
    """
    wire_ns = 0 if near.virtual else frame_time_ns(8, flags, timing)
    found: list[int] = []
    singles = frames_of([(8, flags)] * SINGLES)
    for number, identifier in enumerate(singles["id"].tolist()):
        if number == SILENT and not found:
            break
        begun = near.clock.now()
        near.send(singles[number : number + 1])
        received = only_ours(far.drain(begun + PATIENCE_NS, {identifier}))
        arrived = received["t_ns"][received["id"] == identifier].tolist()
        found += [t_ns - begun - wire_ns for t_ns in arrived[:1]]
        tell(number + 1)
    return np.maximum(1e-3 * np.array(found, float), 0.0)


def loss_at_rate(
    near: Bus, far: Bus, ours: Rows, theirs: Rows, rate_Hz: float, ticks: int, tell: Tell
) -> Loss:
    """Send the frames of a tick at the rate of the loop, `ours` from near and `theirs` from far."""
    only_ours(far.wait(far.clock.now() + _REST_NS))  # late single frames do not count as lost or heard here
    deadlines = Deadlines(rate_Hz, 0.0, clock=near.clock)
    refused = heard = 0
    for tick in range(ticks):
        deadlines.wait()
        refused += near.send(ours) + far.send(theirs)
        heard += len(only_ours(far.drain_now())) + len(only_ours(near.drain_now()))
        tell(tick + 1)
    end = near.clock.now() + _REST_NS
    while near.clock.now() < end:
        heard += len(only_ours(far.wait(min(end, near.clock.now() + 1_000_000))))
        heard += len(only_ours(near.drain_now()))
    sent = ticks * (len(ours) + len(theirs)) - refused
    return Loss(sent, max(sent - heard, 0), refused)


def queue_depth(near: Bus, far: Bus, flags: int = 0) -> int:
    """Frames of 8 bytes accepted at once, at most BURST."""
    taken = BURST - near.send(frames_of([(8, flags)] * BURST))
    end = near.clock.now() + 10 * _REST_NS
    heard = 0
    while heard < taken and near.clock.now() < end:
        heard += len(only_ours(far.wait(near.clock.now() + _REST_NS)))
    return taken


def passes_fd(near: Bus, far: Bus, flags: int = 0) -> bool:
    """True if a CAN FD frame of 64 bytes arrives with its bit-rate switch."""
    near.send(frames_of([(64, FD | BRS | flags)]))
    received = far.wait(near.clock.now() + _REST_NS)
    return bool((((received["flags"] & (FD | BRS)) == FD | BRS) & (received["length"] == 64)).any())


def recovery_ms(near: Bus, far: Bus, channel: str, flags: int = 0) -> float | None:
    """Time, ms, from taking the interface down to the first frame received after it is up again.

    A run does the same after bus-off. None without CAP_NET_ADMIN, or if no frame is received.
    """
    if not netlink.administers():
        return None
    number, begun = socket.if_nametoindex(channel), near.clock.now()
    try:
        netlink.set_up(number, up=False)
    finally:  # after Ctrl-C, too
        netlink.set_up(number, up=True)
    while near.clock.now() < begun + _DOWN_NS:
        near.send(frames_of([(8, flags)]))
        received = only_ours(far.wait(near.clock.now() + 2_000_000))
        if len(received):
            return round(1e-6 * (int(received["t_ns"][0]) - begun), 1)
    return None


def of_interface(name: str) -> Configuration:
    """Configuration `socketcan` on a network interface, with the bit rates that the kernel reports.

    At less than 1 Mbit/s the rate of the loop is lower in proportion, as the bus would not carry its frames.
    """
    found, c = parse(name, netlink.get_link(name)), load("socketcan")
    slower = min((found.bitrate_bit_s or c.bus.bitrate_bit_s) / c.bus.bitrate_bit_s, 1.0)
    bus = {
        "channel": name,
        "layout": "fd" if found.data_bitrate_bit_s else "classic",
        "bitrate_bit_s": found.bitrate_bit_s,
        "data_bitrate_bit_s": found.data_bitrate_bit_s,
    }
    changes = {
        "bus": {k: v for k, v in bus.items() if v},
        "loop": {"rate_Hz": slower * c.loop.rate_Hz},
        "drives": {"watchdog_ms": c.drives.watchdog_ms / slower},
    }
    return loads(with_changes(c.text, changes), name, Path())


def qualify(
    c: Configuration,
    *,
    channel: str | None,
    receiver: str | None,
    duration_s: float,
    tell: Callable[[int, int], None],
) -> tuple[list[str], dict[str, Any]]:
    """Measure a bus, write its qualification file; return (lines to print, summary).

    channel: bus of the configuration, default the first. receiver: another interface of the same bus, which
    receives. duration_s: time of the measurement at loop.rate_Hz, s. Raises RunError, before anything is
    sent, if the bus carries frames of others, or if a run or another program of this kind uses it; LogError
    if the file to write exists and is not a qualification.
    """
    index = c.bus.index_of(channel)
    bus = c.bus.buses[index]
    if bus.layout == "ideal":
        raise ConfigurationError(f"{c.source}: bus.layout: ideal has no bus, allowed: classic, fd")
    if clash := {f.id for f in _listened(c)} & OURS:
        raise ConfigurationError(
            f"{c.source}: drives: 0x{min(clash):X} is an identifier of a drive and of this measurement "
            f"(0x{BLOCK[0]:X} to 0x{BLOCK[-1]:X}): nothing was sent; measure with another configuration"
        )
    path = qualification_path(c, bus)
    check_section_path("", path, Qualification)
    q = _measured(c, index, bus.model_copy(update={"channel": receiver or bus.channel}), duration_s, tell)
    write_section(path, q, _REMARK)
    found = judge(c, index, q)
    trouble = [found.refused] * bool(found.refused) + found.warnings
    good = (
        f"{q.channel} is fit for {c.name} at {q.rate_Hz:g} Hz: feedback within {found.answer_us:.0f} of "
        f"{1e6 * c.loop.window_s(q.rate_Hz):.0f} us, no frame of {q.sent} lost"
    )
    figures = q.model_dump(mode="json")
    printed = figure_rows({key: value for key, value in figures.items() if key not in _UNPRINTED})
    end = f"written: {path}; `hil check` budgets with it, `hil run` compares the adapter"
    lines = [*(trouble or [good]), *(f"  {label:<14}{value}" for label, value in printed), end]
    return lines, figures | {"success": not trouble, "file": str(path), "trouble": trouble}


def _listened(c: Configuration) -> list[Frame]:
    """Examples of all frames between the controller and the drives of a configuration."""
    protocol = build_protocol(c)
    traits = protocol.traits
    requests = protocol.requests(1.0) if isinstance(protocol, MotorProtocol) else ()
    return [*traits.cyclic_frames, *traits.emergency_stop, *chain(*traits.identity_requests, *requests)]


def _measured(
    c: Configuration, index: int, other: BusSettings, duration_s: float, tell: Callable[[int, int], None]
) -> Qualification:
    by_arrival = {"options": {k: v for k, v in other.options.items() if k != HARDWARE_STAMPS}}
    bus, other = (each.model_copy(update=by_arrival) for each in (c.bus.buses[index], other))
    rate = c.loop.rate_Hz
    kernel, ticks = bus.interface == "socketcan", max(round(duration_s * rate), 1)
    cyclic = build_protocol(c).traits.cyclic_frames
    wide = max(f.flags & EXTENDED for f in cyclic)  # for all frames: a moteus may listen to 11 bits
    sent = Counter((len(f.data), f.flags) for f in build_protocol(c).traits.sent if f.bus == index)
    both = bus_budgets(c.bus, c.drives, c.sensors, rate, c.folder)[index].frames
    ours, theirs = (
        frames_of([(length, flags | wide) for length, flags in each.elements()])
        for each in (sent, both - sent)
    )
    with ExitStack() as opened:
        near = opened.enter_context(Bus.open(bus, role="controller"))
        far = opened.enter_context(Bus.open(other, role="plant"))
        if bus.channel == other.channel and not near.virtual and not echoes(bus):
            raise RunError(
                f"the driver of {bus.channel} does not report when a frame was sent, so its own frames say "
                "nothing: connect a second interface to the bus and name it with --receiver"
            )
        opened.enter_context(real_time_rights(c.loop.priority, c.loop.cpu))
        require_quiet(near)
        opened.callback(_emptied, near)
        single = frames_of([(8, wide)])
        stamps = time_stamps(other.channel, lambda: near.send(single)) if kernel else []
        far.drain_now()
        latencies = latencies_us(near, far, BitTiming.of(bus), lambda done: tell(done, SINGLES + ticks), wide)
        if not len(latencies):
            raise RunError(
                f"no frame of {bus.channel} came back to {other.channel}: without another node nobody "
                "acknowledges; check wiring, terminators and bit rates, or name a second interface of this "
                "bus with --receiver"
            )
        ticked = lambda done: tell(SINGLES + done, SINGLES + ticks)  # noqa: E731
        loss = loss_at_rate(near, far, ours, theirs, rate, ticks, ticked)
        queue, fd = queue_depth(near, far, wide), "not used"
        if bus.layout == "fd":
            fd = "passed" if passes_fd(near, far, wide) else "failed"
        events = [near.events(), far.events()]
        recovery = recovery_ms(near, far, bus.channel, wide) if kernel else None
    low, median, high = (round(float(each), 1) for each in np.quantile(latencies, (0.01, 0.5, 0.99)))
    figures: dict[str, Any] = {
        "kind": "adapter", "version": VERSION, "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "channel": bus.channel, "received_on": other.channel, "adapter": identity(bus), "rate_Hz": rate,
        **bus.model_dump(include={"layout", "bitrate_bit_s", "data_bitrate_bit_s"}),
        "latency_us": median, "jitter_us": round((high - low) / 2, 1),
        "longest_us": round(float(latencies.max()), 1), **loss._asdict(), "queue": queue, "can_fd": fd,
        "time_stamps": stamps, "error_frames": sum(each.errors for each in events),
        "overflows": sum(each.overflow for each in events), "recovery_ms": recovery,
    }  # fmt: skip
    return Qualification.model_validate(figures)


def _emptied(near: Bus) -> None:
    """Drop frames that nobody has acknowledged, as far as permitted."""
    with suppress(BusError):
        near.flush_tx()
