"""`hil bus`: CAN FMUs on a simulated bus in lockstep, or on a CAN interface in real time."""

import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from drivers.can.bus_time import BitTiming
from drivers.can.frame_files import CandumpWriter
from drivers.can.link import Link
from drivers.can.localcan.participant import Participant
from drivers.can.socketcan import SocketCan
from drivers.config import BusSettings
from hil.app.files import new_file
from hil.loop.clock import real_time
from plant_fmu.network.attached import Attached
from plant_fmu.network.node import Node
from plant_fmu.network.shared_bus import SharedBus
from plant_fmu.network.station import Station, Stations
from plant_fmu.network.terminal import read_can_fmu

PRIORITY = 70
"""SCHED_FIFO priority in real time: below the controller, by default 80."""


def open_nodes(given: Sequence[str], opened: ExitStack) -> list[Node]:
    """Host the CAN FMUs `FILE.fmu` or `FILE.fmu:TERMINAL`; `opened` closes them. Raises PlantError."""
    nodes = []
    for number, each in enumerate(given):
        file, _, terminal = each.rpartition(":") if ".fmu:" in each else (each, "", "")
        name = f"{Path(file).stem}#{number}"
        nodes.append(opened.enter_context(Node(read_can_fmu(Path(file), terminal), name)))
    return nodes


def _counts(stations: Sequence[Station]) -> dict[str, dict[str, int]]:
    return {
        s.node.name: {"sent": s.sent, "corrupt": s.corrupt, "format_errors_reported": s.reported}
        for s in stations
    }


def run_lockstep(
    fmus: Sequence[str],
    timing: BitTiming,
    step_us: int,
    duration_s: float,
    *,
    error_every: int = 0,
    log: Path | None = None,
) -> dict[str, Any]:
    """Run the CAN FMUs on a simulated bus for `duration_s`, s; return the summary.

    timing: bit rates where no FMU configures them. error_every: destroy each N-th frame; 0: none. log: file
    of the frames as candump writes them, time from 0. Raises PlantError, LogError.
    """
    if log is not None:
        new_file(log, option="--log")
    with ExitStack() as opened:
        nodes = open_nodes(fmus, opened)
        bus = SharedBus(nodes, timing, 1000 * step_us, error_every=error_every)
        if log is not None:
            writer = CandumpWriter(log, ["fmu"])
            opened.callback(writer.close)
            bus.on_frame = lambda end_ns, _, frame: writer.write(end_ns, frame, sent=True)
        begun = time.perf_counter()
        bus.run(round(duration_s * 1e9))
        return {
            "success": True,
            "kind": "bus",
            "interface": "lockstep",
            "duration_s": duration_s,
            "wall_s": time.perf_counter() - begun,
            "frames": bus.frames,
            "destroyed": bus.destroyed,
            "arbitration_lost": bus.lost,
            "load_percent": 100.0 * bus.busy_ns / bus.now_ns,
            "nodes": _counts(bus.stations),
        }


def run_attached(
    fmus: Sequence[str],
    timing: BitTiming,
    step_us: int,
    duration_s: float,
    *,
    interface: str,
    channel: str,
    fd: bool,
) -> dict[str, Any]:
    """Run the CAN FMUs on a CAN interface in real time for `duration_s`, s; return the summary.

    Bit rates of a localcan channel are those that the FMUs configure, else `timing`; socketcan has its own.
    Raises PlantError, BusError.
    """
    with ExitStack() as opened:
        stations = Stations(map(Station, open_nodes(fmus, opened)))
        first = stations.go(0, 1)
        rates = stations.bit_rates(timing)
        links: list[Link] = []
        for _ in stations:
            link: Link
            if interface == "localcan":
                link = Participant(channel, rates, fd=fd, own=True)
            else:
                settings = BusSettings(interface=interface, channel=channel, layout="fd" if fd else "classic")
                own = {"bitrate_bit_s": rates.bitrate, "data_bitrate_bit_s": rates.data_bitrate}
                link = SocketCan(settings.model_copy(update=own))
            opened.callback(link.close)
            links.append(link)
        attached = Attached(stations, links, 1000 * step_us)
        attached.send(first)
        begun = time.monotonic()
        with real_time(PRIORITY, None) as granted, suppress(KeyboardInterrupt):
            attached.run(round(duration_s * 1e9))
        return {
            "success": True,
            "kind": "bus",
            "interface": interface,
            "channel": channel,
            "duration_s": min(duration_s, time.monotonic() - begun),
            "frames": attached.frames,
            "unsent": attached.unsent,
            "arbitration_lost": attached.lost,
            "error_frames": attached.errors,
            "lateness": attached.lateness(),
            "real_time": {"granted": granted.granted, "missing": granted.missing},
            "nodes": _counts(stations),
        }
