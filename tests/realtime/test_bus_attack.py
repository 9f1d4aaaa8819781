"""A minute of all kinds of forged frames on the bus: every run ends held, or powers no drive."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self

import numpy as np
import pytest

from drivers.can.bus import Bus
from drivers.frame_array import sent_array
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Frame
from drivers.signals import LEGS, Command, DriveMode, DriveState, Reaction
from hil.app.check.command import stopping_distances_m
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import Configuration, load
from hil.contracts.messages import Sync
from hil.record.log import Log
from tests.drivers.legs_frames import command_frames, one_feedback, opening, parse
from tests.drivers.received_frames import got
from tests.realtime.rig import Listener, Process, configuration, gone

pytestmark = [pytest.mark.realtime(patient=True), pytest.mark.long]
ATTACK_S = 60.0
FRAMES = 100_000
START_S = 20.0
"""Shortest time before the end of the attack at which a run is started, so that it meets the attack."""
NAMED = {"SECOND_CONTROLLER", "DUPLICATE_NODE", "ESTOP", "REFUSED_FRAMES", "SET_UP", "STALE", "BUS"}


class Attacker:
    """Sends random frames, most of them with a valid CRC. State: the number of sent frames."""

    def __init__(self, c: Configuration, seed: int) -> None:
        protocol = build_protocol(c)
        assert isinstance(protocol, LegsProtocol)
        self._c, self._protocol = c, protocol
        self._random = random.Random(seed)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.sent = 0

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        counter = 0
        with Bus.open(self._c.bus, role="attacker") as bus:
            while not self._over.is_set():
                for received in got(bus.wait(bus.clock.now() + 1_000_000)):
                    heard = parse(self._protocol, received.frame)
                    counter = heard.counter if isinstance(heard, Sync) else counter
                for _ in range(8):
                    frames = self._frames(self._protocol, counter)
                    self.sent += len(frames)
                    bus.send(sent_array(frames))

    def _frames(self, protocol: LegsProtocol, counter: int) -> tuple[Frame, ...]:
        draw = self._random
        near = counter + draw.choice((-1, 0, 0, 0, 1, draw.randrange(256)))
        match draw.randrange(7):
            case 0:
                mode = draw.choice(list(DriveMode))
                force = np.array([draw.uniform(-4e3, 4e3) for _ in range(LEGS)])
                return command_frames(protocol, Command(mode, force), near)
            case 1:
                leg, state = draw.randrange(LEGS), draw.choice(list(DriveState))
                length, rate, force_N = draw.uniform(1, 2), draw.uniform(-1, 1), draw.uniform(-4e3, 4e3)
                return (one_feedback(protocol, leg, length, rate, force_N, int(state), near),)
            case 2:
                watchdog_s = draw.choice((1e-3, 0.15, 4000.0))
                return (protocol.configure(watchdog_s, draw.choice(list(Reaction)))[draw.randrange(LEGS)],)
            case 3:
                return opening(protocol, near)
            case 4 if draw.random() < 0.1:
                return protocol.traits.emergency_stop
            case 5:
                return (Frame(draw.randrange(0x800), draw.randbytes(draw.choice((0, 1, 8)))),) * 8
            case _:
                return (Frame(0, bytes(8)),) * 4


def travelled_m(log: Log) -> float:
    """True travel of a leg after a drive left RUN, or in the whole log if none was in RUN."""
    rows = log.rows()
    run = (rows["drive_state"] == DriveState.RUN).all(axis=1)
    over = np.flatnonzero(run[:-1] & ~run[1:])
    rows = rows[over[0] :] if over.size else rows
    return float(np.abs(rows["length"] - rows["length"][0]).max())


def ended_by_name(run: Process) -> None:
    """Assert that a run ends and names the attack."""
    assert run.wait() == 1, run.errors
    assert any(name in run.errors for name in NAMED), run.errors


def test_forged_frames_on_the_bus_move_no_leg_beyond_the_stopping_distance(
    tmp_path: Path, start: Callable[..., Process], listen: Callable[[Path], Listener]
) -> None:
    """The first run is attacked during motion, the others from before their start.

    A run with legs that seem to move, by forged feedback, stays on and ends after the attack.
    """
    file = configuration(tmp_path)
    c = load(str(file))
    attacker = Attacker(c, seed=0)
    run = start("run", str(file), "--plant")
    listen(file).wait_for_motion(run, 0.05)
    with attacker:
        end = time.monotonic() + ATTACK_S
        while time.monotonic() < end:
            if gone(run.pid) and end - time.monotonic() > START_S:
                ended_by_name(run)
                run = start("run", str(file), "--plant")
            time.sleep(0.1)
    ended_by_name(run)
    print(f"{attacker.sent} frames")
    assert attacker.sent >= FRAMES
    logs = list((tmp_path / "runs").glob("*-plant.mcap"))
    assert logs
    for log in map(Log.open, logs):
        assert travelled_m(log) <= stopping_distances_m(c)[0]
