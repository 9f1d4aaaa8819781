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
from drivers.protocol import Frame
from hil.app.files import new_file
from plant_fmu.network.attached import Attached
from plant_fmu.network.node import Node
from plant_fmu.network.shared_bus import SharedBus
from plant_fmu.network.station import Station, bit_rates, exchange
from plant_fmu.network.terminal import read_can_fmu


def open_nodes(given: Sequence[str], opened: ExitStack) -> list[Node]:
    """Host the CAN FMUs `FILE.fmu` or `FILE.fmu:TERMINAL`; `opened` closes them. Raises PlantError."""
    nodes = []
    for number, each in enumerate(given):
        file, _, terminal = each.rpartition(":") if ".fmu:" in each else (each, "", "")
        name = f"{Path(file).stem}#{number}"
        nodes.append(opened.enter_context(Node(read_can_fmu(Path(file), terminal), name)))
    return nodes


def _counts(stations: Sequence[Station]) -> list[dict[str, Any]]:
    return [
        {"name": s.node.name, "sent": s.sent, "corrupt": s.corrupt, "format_errors_reported": s.reported}
        for s in stations
    ]


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
        new_file(log)
    with ExitStack() as opened:
        nodes = open_nodes(fmus, opened)
        writer = None if log is None else CandumpWriter(log, ["fmu"])
        if writer is not None:
            opened.callback(writer.close)

        def on_frame(end_ns: int, _: int, frame: Frame) -> None:
            if writer is not None:
                writer.write(end_ns, frame, sent=True)

        bus = SharedBus(nodes, timing, 1000 * step_us, error_every=error_every, on_frame=on_frame)
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
        stations = [Station(node) for node in open_nodes(fmus, opened)]
        first = [exchange(stations, index) for index in range(len(stations))]
        rates = bit_rates(stations, timing)
        links: list[Link] = []
        for _ in stations:
            link: Link
            if interface == "localcan":
                link = Participant(channel, rates, fd=fd, own=True)
            else:
                settings = BusSettings(interface=interface, channel=channel, layout="fd" if fd else "classic")
                link = SocketCan(settings.model_copy(update=_rates(rates)))
            opened.callback(link.close)
            links.append(link)
        attached = Attached(stations, links, 1000 * step_us)
        for index, operations in enumerate(first):
            attached.accept(index, operations)
        begun = time.monotonic()
        with suppress(KeyboardInterrupt):
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
            "lateness_us": attached.lateness_us(),
            "nodes": _counts(stations),
        }


def _rates(rates: BitTiming) -> dict[str, int]:
    return {"bitrate_bit_s": rates.bitrate, "data_bitrate_bit_s": rates.data_bitrate}
