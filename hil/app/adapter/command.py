"""`hil adapter`: measures a CAN interface under the frames and the rate of a configuration."""

import platform
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from drivers.can import netlink
from drivers.can.adapter import Stamped, echoes, identity
from drivers.can.bus import Bus
from drivers.can.bus_time import BitTiming
from drivers.can.can_interface import CanInterface, parse
from drivers.config import BusSettings
from drivers.errors import ConfigurationError, RunError
from hil.app.adapter import measure
from hil.app.adapter.budget import Judgement, judge
from hil.app.adapter.file import VERSION, Qualification, qualification_path, write_qualification
from hil.app.compose import build_protocol
from hil.app.configuration.bus_budget import bus_budgets
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.loop.clock import real_time_rights


def of_interface(name: str) -> Configuration:
    """Configuration `socketcan` on a network interface, with the bit rates that the kernel reports."""
    found, c = parse(name, netlink.get_link(name)), load("socketcan")
    bus = {
        "channel": name,
        "layout": "fd" if found.data_bitrate_bit_s else "classic",
        "bitrate_bit_s": found.bitrate_bit_s,
        "data_bitrate_bit_s": found.data_bitrate_bit_s,
    }
    return loads(with_changes(c.text, {"bus": {k: v for k, v in bus.items() if v}}), name, Path())


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
    sent, if the bus carries frames of others, or if a run or another program of this kind uses it.
    """
    index = c.bus.index_of(channel)
    bus = c.bus.buses[index]
    if bus.layout == "ideal":
        raise ConfigurationError(f"{c.source}: bus.layout: ideal has no bus, allowed: classic, fd")
    clash = {each.id for each in build_protocol(c).traits.cyclic_frames} & set(measure.BLOCK)
    if clash:
        raise ConfigurationError(
            f"{c.source}: drives.node_ids: 0x{min(clash):X} is an identifier of a drive and of this "
            f"measurement (0x{measure.BLOCK[0]:X} to 0x{measure.BLOCK[-1]:X}): nothing was sent"
        )
    other = bus.model_copy(update={"channel": receiver or bus.channel})
    file = _measured(c, index, (bus, other), duration_s, tell)
    path = qualification_path(c, bus)
    write_qualification(path, file)
    found = judge(c, index, file)
    trouble = [found.refused] * bool(found.refused) + found.warnings
    summary = {"success": not trouble, "kind": "adapter", "file": str(path), "trouble": trouble}
    return _lines(c, file, found, trouble, path), summary | file.model_dump(mode="json", exclude={"kind"})


def _measured(
    c: Configuration,
    index: int,
    ends: tuple[BusSettings, BusSettings],
    duration_s: float,
    tell: Callable[[int, int], None],
) -> Qualification:
    bus, other = ends
    rate, timing, kernel = c.loop.rate_Hz, BitTiming.of(bus), bus.interface == "socketcan"
    ticks = max(round(duration_s * rate), 1)
    whole = measure.SINGLES + ticks
    with ExitStack() as opened:
        near = opened.enter_context(Bus.open(bus, role="controller"))
        far = opened.enter_context(Bus.open(other, role="plant"))
        if bus.channel == other.channel and not near.virtual and not echoes(bus):
            raise RunError(
                f"the driver of {bus.channel} does not report when a frame was sent, so its own frames say "
                "nothing: connect a second interface to the bus and name it with --receiver"
            )
        opened.enter_context(real_time_rights(c.loop.priority, c.loop.cpu))
        measure.require_quiet(near)
        stamps: list[str] = []
        if kernel:
            with closing(Stamped(other.channel)) as stamped:
                near.send(measure.frames_of([(8, 0)]))
                stamps = stamped.kinds()
        far.drain_now()
        latencies = measure.latencies_us(near, far, timing, lambda done: tell(done, whole))
        if not len(latencies):
            raise RunError(
                f"no frame of {bus.channel} came back to {other.channel}: without another node nobody "
                "acknowledges; check wiring, terminators and bit rates, or name a second interface of this "
                "bus with --receiver"
            )
        sent = Counter((len(f.data), f.flags) for f in build_protocol(c).traits.sent if f.bus == index)
        frames = bus_budgets(c.bus, c.drives, c.sensors, rate, c.folder)[index].frames
        shapes = list(sent.elements()), list((frames - sent).elements())
        ours, theirs = (measure.frames_of(each) for each in shapes)
        ticked = lambda done: tell(measure.SINGLES + done, whole)  # noqa: E731
        loss = measure.loss_at_rate(near, far, ours, theirs, rate, ticks, ticked)
        queue, filled = measure.queue_depth(near, far)
        fd: Literal["passed", "failed", "not used"] = "not used"
        if bus.layout == "fd":
            fd = "passed" if measure.passes_fd(near, far) else "failed"
        events = [near.events(), far.events()]
        recovery = measure.recovery_ms(near, far, bus.channel) if kernel else None
    low, high = np.quantile(latencies, (0.01, 0.99))
    state: CanInterface | None = parse(bus.channel, netlink.get_link(bus.channel)) if kernel else None
    return Qualification(
        kind="adapter", version=VERSION, date=datetime.now(UTC).isoformat(timespec="seconds"),
        interface=bus.interface, channel=bus.channel, receiver=other.channel, adapter=identity(bus),
        kernel=platform.release(), rate_Hz=rate, layout=bus.layout, bitrate_bit_s=bus.bitrate_bit_s,
        data_bitrate_bit_s=bus.data_bitrate_bit_s, latency_us=round(float(np.median(latencies)), 1),
        jitter_us=round(float(high - low) / 2, 1), worst_us=round(float(latencies.max()), 1),
        **loss._asdict(), queue=queue, queue_filled=filled, fd=fd, stamps=stamps,
        error_frames=sum(each.errors for each in events), overflows=sum(each.overflow for each in events),
        restart_ms=state.restart_ms if state is not None and state.has_controller else None,
        recovery_ms=None if recovery is None else round(recovery, 1),
    )  # fmt: skip


def _lines(c: Configuration, q: Qualification, found: Judgement, trouble: list[str], path: Path) -> list[str]:
    """Verdict, then the figures."""
    window_us = 1e6 * c.loop.window_s(q.rate_Hz)
    path_of = "back to the same interface" if q.receiver == q.channel else f"to {q.receiver}"
    good = (
        f"{q.channel} is fit for {c.name} at {q.rate_Hz:g} Hz: feedback within {found.answer_us:.0f} of "
        f"{window_us:.0f} us, no frame of {q.sent} lost"
    )
    after = "not measured (needs CAP_NET_ADMIN)" if q.recovery_ms is None else f"{q.recovery_ms:.0f} ms"
    restart = "no controller" if q.restart_ms is None else f"restart-ms {q.restart_ms}"
    return [
        *(trouble or [good]),
        f"  adapter       {q.adapter}, {q.interface}:{q.channel}, kernel {q.kernel}",
        f"  latency       {q.latency_us:.0f} us, jitter {q.jitter_us:.0f} us, longest {q.worst_us:.0f} us",
        f"  frames come   {path_of}",
        f"  loss          {q.lost} of {q.sent} frames ({q.loss:.2%}), {q.unsent} refused",
        f"  queue         {q.queue} frames at once" + ("" if q.queue_filled else ", none refused"),
        f"  CAN FD        {q.fd}",
        f"  time stamps   {', '.join(q.stamps) or 'none by the kernel'}",
        f"  errors        {q.error_frames} error frames, {q.overflows} received frames lost by overflow",
        f"  after bus-off {restart}; down and up again {after}",
        f"written: {path}; `hil check` budgets with it, `hil run` compares the adapter",
    ]
