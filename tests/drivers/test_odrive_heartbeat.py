"""An axis that tells by its heartbeat alone, now and then, whether it is enabled: what holds in between."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
import pytest

from drivers.config import TransmissionSettings
from drivers.protocol import Frame, Received
from drivers.signals import LEGS, Command, DriveMode, DriveState
from drivers.transmission import Transmission
from hil.contracts.ends import BEAT_TICKS, FORCE, OFF, PERIOD_NS
from hil.contracts.line import READY, RESET, Line
from tests.drivers.motor_families import ODriveProtocol

NODES = (0, 1, 2, 3, 5, 62)
GEAR = Transmission(TransmissionSettings(lead_m=0.1, sign=[1, -1, 1, -1, 1, -1], offset_m=1.75))
HEARTBEAT, AXIS_STATE, TORQUE = 0x01, 0x07, 0x0E
FORCED = Command(DriveMode.RUN, FORCE)


def line() -> Line:
    """Return both ends, set up, with axes whose loops are not closed."""
    ends = Line(ODriveProtocol(NODES, 0.05, GEAR))
    ends.until_set_up()
    for _ in range(2):
        ends.step(READY, set_up=False)
    return ends


def asked(frames: Sequence[Frame], kind: int, state: int | None = None) -> list[int]:
    """Return the legs that are sent a frame of a kind, of a state where one is given, in order."""
    data = None if state is None else struct.pack("<Ixxxx", state)
    return [NODES.index(f.id >> 5) for f in frames if f.id & 0x1F == kind and data in (None, f.data)]


def mute(frames: list[Received]) -> list[Received]:
    return [each for each in frames if each.frame.id & 0x1F != HEARTBEAT]


def test_each_axis_has_its_force_from_the_tick_on_in_which_it_is_asked_to_close_its_loop():
    ends = line()
    ends.to_hear = mute
    for _ in range(3 * BEAT_TICKS):
        ends.step(FORCED, set_up=False)
        np.testing.assert_allclose(ends.nodes.snapshot().command, FORCE, rtol=1e-6, atol=1e-3)
        assert asked(ends.sent, TORQUE) == list(range(LEGS)), "it feeds the watchdog, which is 0.05 s"
    assert ends.nodes.snapshot().state.tolist() == [DriveState.RUN] * LEGS


def test_an_axis_is_asked_once_to_close_its_loop():
    ends, legs = line(), list[int]()
    for _ in range(6 * BEAT_TICKS):
        ends.step(FORCED, set_up=False)
        legs += asked(ends.sent, AXIS_STATE)
    assert legs == list(range(LEGS))


@pytest.mark.parametrize("leg", range(LEGS))
def test_an_axis_that_says_after_a_while_that_its_loop_is_open_is_asked_again_and_no_other(leg):
    ends, legs = line(), list[int]()
    lost = Frame(NODES[leg] << 5 | AXIS_STATE, struct.pack("<Ixxxx", 8))
    ends.to_obey = lambda frames: [frame for frame in frames if frame != lost]
    ends.step(FORCED, set_up=False)
    ends.to_obey = list
    assert ends.nodes.snapshot().state.tolist().count(DriveState.RUN) == LEGS - 1
    for _ in range(4 * BEAT_TICKS):
        ends.step(FORCED, set_up=False)
        legs += asked(ends.sent, AXIS_STATE)
    assert legs == [leg]
    assert ends.states() == [DriveState.RUN] * LEGS


def test_an_axis_that_has_run_and_says_that_it_is_idle_is_not_asked_again_until_run_is_asked_for_anew():
    ends, legs = line(), list[int]()
    ends.restart()
    idle = Frame(NODES[3] << 5 | AXIS_STATE, struct.pack("<Ixxxx", 1))
    ends.step(FORCED, set_up=False, first=(idle,))
    for _ in range(6 * BEAT_TICKS):
        ends.step(FORCED, set_up=False)
        legs += asked(ends.sent, AXIS_STATE)
    assert legs == []
    assert ends.states() == [DriveState.BOOT if leg == 3 else DriveState.RUN for leg in range(LEGS)]
    ends.restart()


@pytest.mark.parametrize("mode", [DriveMode.READY, DriveMode.OFF])
@pytest.mark.parametrize("ticks", [1, 2, BEAT_TICKS // 2])
def test_an_axis_that_was_enabled_for_less_than_a_heartbeat_is_told_to_be_idle_and_counts_as_enabled(
    mode, ticks
):
    ends = line()
    ends.to_hear = mute
    for _ in range(ticks):
        ends.step(FORCED, set_up=False)
    for _ in range(3):
        ends.step(Command(mode, FORCE), set_up=False)
        assert asked(ends.sent, AXIS_STATE, 1) == list(range(LEGS))
    assert ends.nodes.snapshot().brake.all()
    assert ends.states() == [DriveState.RUN] * LEGS, "no axis has said that its brake is shut"
    ends.to_hear = list
    for _ in range(BEAT_TICKS + 1):
        ends.step(Command(mode, FORCE), set_up=False)
    assert ends.states() == [DriveState.READY if mode == DriveMode.READY else DriveState.OFF] * LEGS


@pytest.mark.parametrize("anew", [False, True])
def test_a_reset_clears_the_errors_of_axes_that_have_not_yet_told_them(anew):
    ends = line()
    ends.to_hear = mute
    ends.step(OFF, first=ends.protocol.traits.emergency_stop)
    assert ends.nodes.snapshot().state.tolist() == [DriveState.FAULT] * LEGS
    if anew:
        ends.begin_anew()
    for _ in range(ends.protocol.traits.reset_ticks):
        ends.step(RESET)
    assert ends.nodes.snapshot().state.tolist() == [DriveState.OFF] * LEGS


def test_the_emulated_axis_sends_its_heartbeat_by_a_timer_and_none_with_a_change():
    ends, told = line(), list[tuple[int, int]]()

    def hear(frames: list[Received]) -> list[Received]:
        told.extend((t_ns, frame.id >> 5) for t_ns, frame in frames if frame.id & 0x1F == HEARTBEAT)
        return frames

    ends.to_hear = hear
    for command in (FORCED, READY, FORCED, OFF, RESET, OFF) * 4:
        ends.step(command, set_up=False, first=ends.protocol.traits.emergency_stop if command == OFF else ())
    times = [t_ns for t_ns, _ in told]
    assert len(told) > 3 * LEGS
    assert set(np.diff(times)) == {BEAT_TICKS * PERIOD_NS // LEGS}
    assert {node for _, node in told[:LEGS]} == set(NODES)


def test_an_axis_whose_heartbeats_go_on_is_none_that_starts_anew_although_no_other_frame_comes():
    ends = line()
    ends.to_hear = lambda frames: [each for each in frames if each.frame.id & 0x1F == HEARTBEAT]
    for _ in range(12 * BEAT_TICKS):
        ends.step(READY, set_up=False)
        assert DriveState.BOOT not in ends.dialogue.power


def test_an_axis_that_is_asked_to_close_its_loop_is_ready_until_its_heartbeat_says_that_it_has():
    ends = line()
    ends.to_hear = mute
    for _ in range(BEAT_TICKS):
        ends.step(FORCED, set_up=False)
        assert ends.states() == [DriveState.READY] * LEGS
    ends.to_hear = list
    for _ in range(BEAT_TICKS + 1):
        ends.step(FORCED, set_up=False)
    assert ends.states() == [DriveState.RUN] * LEGS
