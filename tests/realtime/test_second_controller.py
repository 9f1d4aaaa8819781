"""A third process on localcan acts as a controller: the run ends held and names it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.can.bus import Bus
from drivers.frame_array import sent_array
from drivers.protocol import Frame
from drivers.signals import Command, DriveMode, Reaction
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import load
from hil.contracts.messages import Sync
from tests.drivers.legs_frames import command_frames, opening, parse
from tests.drivers.received_frames import got
from tests.realtime.rig import END_S, LASTING, Listener, Process, configuration, gone

pytestmark = pytest.mark.realtime(patient=True)
FORGED = Command(DriveMode.RUN, np.full(6, 3e3))
ATTACKS: dict[str, Callable[..., tuple[Frame, ...]]] = {
    "command": lambda protocol, cycle: command_frames(protocol, FORGED, cycle),
    "CONFIG": lambda protocol, cycle: protocol.configure(4000.0, Reaction.ZERO)[cycle % 6 :][:1],
    "SYNC": lambda protocol, cycle: opening(protocol, cycle + 7),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", ATTACKS)
def test_second_controller_on_the_bus_during_motion_ends_the_run_with_the_platform_held(
    tmp_path: Path, start: Callable[..., Process], listen: Callable[[Path], Listener], kind: str
) -> None:
    file = configuration(tmp_path, LASTING)
    c = load(str(file))
    protocol = build_protocol(c)
    listener = listen(file)
    run = start("run", str(file), "--plant")
    listener.wait_for_motion(run, 0.05)
    with Bus.open(c.bus, role="attacker") as bus:
        end, sent = time.monotonic() + END_S, 0
        while sent < 50 and time.monotonic() < end and not gone(run.pid):
            for received in got(bus.wait(bus.clock.now() + 20_000_000)):
                heard = parse(protocol, received.frame)
                if isinstance(heard, Sync):
                    bus.send(sent_array(ATTACKS[kind](protocol, heard.counter)))
                    sent += 1
    assert sent
    assert run.wait() == 1
    assert "SECOND_CONTROLLER" in run.errors
    assert f"frames received from it: {kind.upper()}" in run.errors
    assert run.summary["plant"]["final_states"] == ["FAULT"] * 6, (
        "the drives stopped at once and stay in fault"
    )
