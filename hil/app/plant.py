"""`hil plant`: the other end of the bus in real time - six emulated drives in front of a plant.

It also tests somebody else's controller: it knows frames and time only.
"""

from __future__ import annotations

import os
import select
import signal
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from drivers.bus import Bus
from drivers.protocol import Frame, Received
from drivers.signals import DriveState
from hil.app.compose import attachments, build_nodes, build_scene
from hil.app.configuration import Configuration
from hil.app.output import log_path
from hil.clock import real_time
from hil.record import Recording
from plant_fmu.nodes import Nodes, Snapshot

IDLE_NS = 250_000
"""The plant never lags the present by more than this, so that little is left to compute at a SYNC."""
ORPHAN_S = 3.0
"""A supervised plant outlives its supervisor by this: time for the drives to bring the platform to rest."""

PLANT_ROW = np.dtype(
    [
        ("tick", "<i8"),
        ("t_ns", "<i8"),
        ("commands", "<i8"),
        ("repeated", "<i8"),
        ("rejected", "<i8"),
        ("drive_state", "<i8", (6,)),
        ("drive_fault", "<i8", (6,)),
        ("length", "<f8", (6,)),
        ("rate", "<f8", (6,)),
        ("command", "<f8", (6,)),
        ("force", "<f8", (6,)),
        ("applied_force", "<f8", (6,)),
        ("brake", "<f8", (6,)),
        ("wrench", "<f8", (6,)),
        ("p", "<f8", (3,)),
        ("R", "<f8", (9,)),
        ("twist", "<f8", (6,)),
    ]
)
"""One SYNC of the plant's log: the truth that the controller does not know. NaN where there is no pose."""
UNITS = {
    "t_ns": "ns", "length": "m", "rate": "m/s", "command": "N", "force": "N", "applied_force": "N",
    "brake": "1 engaged", "wrench": "N, N m", "p": "m", "twist": "m/s, rad/s",
}  # fmt: skip


def plant_row(s: Snapshot) -> np.ndarray[Any, np.dtype[np.void]]:
    """Return one element of PLANT_ROW."""
    row = np.zeros((), PLANT_ROW)
    truth = s.truth
    row[()] = (
        s.syncs, s.t_ns, s.commands, s.repeated, s.rejected, s.state, s.fault, s.length, s.rate, s.command,
        s.force, s.applied, s.brake, s.wrench,
        *((np.nan, np.nan, np.nan) if truth is None else (truth.p, truth.R.ravel(), truth.twist)),
    )  # fmt: skip
    return row


def run_plant(
    configuration: Configuration,
    *,
    log: Path | None = None,
    duration_s: float | None = None,
    supervisor: int | None = None,
    ready: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Serve the drives until SIGINT, SIGTERM, `duration_s`, or ORPHAN_S after the supervisor's pipe closed.

    Raises ConfigurationError, BusError, PlantError.
    """
    c = configuration
    c.require("plant")
    assert c.plant is not None
    nodes, physics = build_nodes(c)
    recording = None
    if c.plant.log:
        recording = Recording.start(
            log_path(c.recording.folder, c.name, log, "-plant"),
            configuration=c.text,
            dtype=PLANT_ROW,
            topic="/plant",
            attachments=attachments(c),
            metadata={"kind": "plant"},
            units=UNITS,
            scene=build_scene(c),
            can_channel=c.bus.channel,
            ring_ticks=c.recording.ring_ticks,
        )
    try:
        with recording or nullcontext(), Bus.open(c.bus, role="plant") as bus:
            stop = _Stop()
            with real_time(max(1, c.loop.priority - 10), None):
                ready()
                last = _serve(nodes, bus, recording, stop, duration_s, supervisor)
            summary: dict[str, Any] = {
                "success": True,
                "kind": "plant",
                "ending": stop.reason,
                "syncs": last.syncs,
                "commands": last.commands,
                "rejected_frames": last.rejected,
                "final_states": [DriveState(int(s)).name for s in last.state],
                "peak_final_rate_m_s": float(np.abs(last.rate).max()),
            }
            if recording is not None:
                closed = recording.close({k: v for k, v in summary.items() if k != "success"})
                summary |= {"log": str(closed.path), "dropped_ticks": closed.dropped}
    finally:
        physics.close()
    return summary


class _Stop:
    """Why to end; set by SIGINT and SIGTERM."""

    def __init__(self) -> None:
        self.reason = ""
        for s in (signal.SIGINT, signal.SIGTERM):
            signal.signal(s, self._on_signal)

    def _on_signal(self, signum: int, frame: FrameType | None) -> None:
        del frame
        self.reason = signal.Signals(signum).name


def _serve(
    nodes: Nodes,
    bus: Bus,
    recording: Recording | None,
    stop: _Stop,
    duration_s: float | None,
    supervisor: int | None,
) -> Snapshot:
    now = time.monotonic_ns()
    nodes.start(now)
    end = None if duration_s is None else now + round(duration_s * 1e9)
    next_look = now
    sent: list[Frame] = []
    heard: list[Received] = []
    snapshot = nodes.snapshot()
    while not stop.reason:
        received = bus.wait(now + IDLE_NS)
        now = time.monotonic_ns()
        outgoing = [frame for _, frame in nodes.step(now, received)]
        if outgoing:
            bus.send(outgoing)
        if recording is not None:
            heard += received
            sent += outgoing
            snapshot_due = nodes.syncs != snapshot.syncs
            if snapshot_due:
                snapshot = nodes.snapshot()
                recording.tick(plant_row(snapshot), heard, sent)
                heard, sent = [], []
        if now >= next_look:
            next_look = now + 20_000_000
            if end is not None and now >= end:
                stop.reason = "duration"
            if (
                supervisor is not None
                and select.select([supervisor], [], [], 0)[0]
                and not os.read(supervisor, 1)
            ):
                supervisor, end = None, now + round(ORPHAN_S * 1e9)
    return nodes.snapshot()
