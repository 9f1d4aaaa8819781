"""Timers of an axis: heartbeats report its state, and estimates arrive next to its answers."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings
from drivers.frame_array import received_array, sent_array
from drivers.protocol import Frame, Received
from drivers.signals import LEGS, Command, DriveMode, DriveState, Reaction
from hil.app.adapter.qualification import answered_ns
from hil.app.configuration.bus_budget import timed_feedbacks
from hil.app.derive_encoder_limits import encoder_limits
from hil.contracts.loopback import BEAT_TICKS, FORCE, OFF, PERIOD_NS, READY, RESET, SETUP, Ends, Line, at_tick
from hil.loop.latch_times import checked
from tests.drivers.motor_families import GEAR, ODriveProtocol, odrive
from tests.drivers.motor_families import ODRIVE_NODES as NODES
from tests.hil.lab.bringup.families import family

HEARTBEAT, AXIS_STATE, ESTIMATES, TORQUE = 0x01, 0x07, 0x09, 0x0E
FORCED = Command(DriveMode.RUN, FORCE)


# heartbeats


def line() -> Line:
    """Both ends, set up, with axes whose loops are open."""
    ends = Line(odrive())
    ends.until_set_up()
    for _ in range(2):
        ends.step(READY, set_up=False)
    return ends


def asked(frames: Sequence[Frame], kind: int, state: int | None = None) -> list[int]:
    """Legs that get a frame of a kind, and of a state if given, in order."""
    data = None if state is None else struct.pack("<Ixxxx", state)
    return [NODES.index(f.id >> 5) for f in frames if f.id & 0x1F == kind and data in (None, f.data)]


def asked_while_run(ends: Line) -> list[int]:
    """Legs that are told to close their loops during six heartbeats of RUN."""
    legs: list[int] = []
    for _ in range(6 * BEAT_TICKS):
        ends.step(FORCED, set_up=False)
        legs += asked(ends.sent, AXIS_STATE)
    return legs


def mute(frames: list[Received]) -> list[Received]:
    return [each for each in frames if each.frame.id & 0x1F != HEARTBEAT]


def test_axis_gives_force_at_once_and_is_reported_ready_until_its_first_heartbeat():
    ends = line()
    ends.to_hear = mute
    for _ in range(3 * BEAT_TICKS):
        ends.step(FORCED, set_up=False)
        np.testing.assert_allclose(ends.nodes.snapshot().command, FORCE, rtol=1e-6, atol=1e-3)
        assert asked(ends.sent, TORQUE) == list(range(LEGS)), "this feeds the watchdog of 0.05 s"
        assert ends.states() == [DriveState.READY] * LEGS
    assert ends.nodes.snapshot().state.tolist() == [DriveState.RUN] * LEGS
    ends.to_hear = list
    for _ in range(BEAT_TICKS + 1):
        ends.step(FORCED, set_up=False)
    assert ends.states() == [DriveState.RUN] * LEGS


def test_axis_gets_one_closed_loop_request_and_another_if_its_loop_stays_open():
    assert asked_while_run(line()) == list(range(LEGS))
    ends, lost = line(), Frame(NODES[3] << 5 | AXIS_STATE, struct.pack("<Ixxxx", 8))
    ends.to_obey = lambda frames: [frame for frame in frames if frame != lost]
    ends.step(FORCED, set_up=False)
    ends.to_obey = list
    assert ends.nodes.snapshot().state.tolist().count(DriveState.RUN) == LEGS - 1
    assert asked_while_run(ends) == [3]
    assert ends.states() == [DriveState.RUN] * LEGS
    # only a new RUN enables an axis again that had run
    idle = Frame(NODES[3] << 5 | AXIS_STATE, struct.pack("<Ixxxx", 1))
    ends.step(FORCED, set_up=False, first=(idle,))
    assert asked_while_run(ends) == []
    assert ends.states() == [DriveState.BOOT if leg == 3 else DriveState.RUN for leg in range(LEGS)]
    ends.restart()


@pytest.mark.parametrize("mode", [DriveMode.READY, DriveMode.OFF])
@pytest.mark.parametrize("ticks", [1, 2, BEAT_TICKS // 2])
def test_axis_enabled_for_less_than_a_heartbeat_period_counts_as_enabled_until_it_reports(mode, ticks):
    ends = line()
    ends.to_hear = mute
    for _ in range(ticks):
        ends.step(FORCED, set_up=False)
    for _ in range(3):
        ends.step(Command(mode, FORCE), set_up=False)
        assert asked(ends.sent, AXIS_STATE, 1) == list(range(LEGS))
    assert ends.nodes.snapshot().brake.all()
    assert ends.states() == [DriveState.RUN] * LEGS, "no axis has reported its brake closed"
    ends.to_hear = list
    for _ in range(BEAT_TICKS + 1):
        ends.step(Command(mode, FORCE), set_up=False)
    assert ends.states() == [DriveState.READY if mode == DriveMode.READY else DriveState.OFF] * LEGS


@pytest.mark.parametrize("anew", [False, True])
def test_reset_clears_errors_that_odrive_axes_have_not_yet_reported(anew):
    ends = line()
    ends.to_hear = mute
    ends.step(OFF, first=ends.protocol.traits.emergency_stop)
    assert ends.nodes.snapshot().state.tolist() == [DriveState.FAULT] * LEGS
    if anew:
        ends.replace_controller()
    for _ in range(ends.protocol.traits.reset_ticks):
        ends.step(RESET)
    assert ends.nodes.snapshot().state.tolist() == [DriveState.OFF] * LEGS


def test_emulated_axis_sends_its_heartbeat_by_a_timer_only():
    ends, beats = line(), list[tuple[int, int]]()

    def hear(frames: list[Received]) -> list[Received]:
        beats.extend((t_ns, frame.id >> 5) for t_ns, frame in frames if frame.id & 0x1F == HEARTBEAT)
        return frames

    ends.to_hear = hear
    for command in (FORCED, READY, FORCED, OFF, RESET, OFF) * 4:
        ends.step(command, set_up=False, first=ends.protocol.traits.emergency_stop if command == OFF else ())
    assert len(beats) > 3 * LEGS
    assert set(np.diff([t_ns for t_ns, _ in beats])) == {BEAT_TICKS * PERIOD_NS // LEGS}
    assert {node for _, node in beats[:LEGS]} == set(NODES)


# estimates that nobody asked for


UNASKED_S = 0.01


def ready(unasked_s: float = UNASKED_S) -> Ends:
    ends = Ends(ODriveProtocol(NODES, 0.05, GEAR, unasked_s=unasked_s))
    ends.until_set_up()
    return ends


def estimate(leg: int, turns: float) -> Frame:
    return Frame(NODES[leg] << 5 | ESTIMATES, struct.pack("<ff", turns, 0.5))


def heard(ends: Ends, *coming: tuple[int, Frame]) -> Any:
    """Measurement of the next tick from frames with times in ns after its start."""
    begun = (ends.tick + 1) * PERIOD_NS
    tick = at_tick(ends.tick + 1)
    run = received_array([Received(begun + t_ns, frame) for t_ns, frame in coming])
    ends.protocol.decode(ends.dialogue, run, ends.measurement, tick, begun)
    return tick


ANSWERS = tuple((300_000, estimate(leg, 0.1 * leg)) for leg in range(LEGS))
BEFORE = tuple((-500_000, estimate(leg, 7.0)) for leg in range(LEGS))


@pytest.mark.parametrize("leg", range(LEGS))
def test_newest_position_estimate_after_the_poll_is_used_and_earlier_ones_are_not(leg):
    tick = heard(ready(), *BEFORE, *ANSWERS, (400_000, estimate(leg, 0.9)))
    expected = np.array([0.9 if each == leg else 0.1 * each for each in range(LEGS)])
    np.testing.assert_allclose(tick["length"], GEAR.length(expected), rtol=1e-6)
    assert (tick["doubled"], tick["rejected"], tick["age"].tolist()) == (0, 0, [0] * LEGS)


def test_second_and_late_estimates_count_as_errors_if_the_axis_sends_none_by_timer():
    tick = heard(ready(0.0), BEFORE[0], *ANSWERS, (400_000, estimate(3, 0.9)))
    assert (tick["doubled"], tick["rejected"]) == (1 << 3, 1)


@pytest.mark.parametrize("unasked_s", [0.0, UNASKED_S])
def test_emulated_axis_sends_estimates_by_timer_next_to_its_answers(unasked_s):
    ends, times = ready(unasked_s), list[int]()
    for _ in range(100):
        ends.step()
        polled = ends.tick * PERIOD_NS + 100_000
        found = [t_ns for t_ns, frame in ends.received if frame.id == NODES[2] << 5 | ESTIMATES]
        assert polled in found
        times += [t_ns for t_ns in found if t_ns != polled]
    assert (len(times) > 3) == bool(unasked_s)
    assert not times or np.abs(np.diff(times) - 1e9 * UNASKED_S).max() <= 1
    assert ends.nodes.syncs == (ends.tick + 1) * LEGS, "none counts as a poll"


def configured(options: dict[str, int], **bus: Any) -> Any:
    values = {"protocol": "odrive", "transmission": {"lead_m": 0.02}, "options": options}
    settings = BusSettings.model_validate({"layout": "classic"} | bus)
    return build_protocol(settings, DriveSettings.model_validate(values))


@pytest.mark.parametrize(
    ("options", "rate_Hz", "frames"),
    [({}, 312.5, 1), ({}, 200.0, 3), ({}, 100.0, 6), ({}, 50.0, 12), ({"encoder_msg_rate_ms": 0}, 50.0, 0)],
)
def test_estimates_that_axes_send_by_timer_are_in_the_bus_budget_of_every_period(options, rate_Hz, frames):
    found = timed_feedbacks(configured(options), rate_Hz)
    assert [(len(frame.data), frame.flags) for frame in found] == [(8, 0)] * frames
    channels = [{"channel": "a", "legs": [0, 1, 2, 3]}, {"channel": "b", "legs": [4, 5]}]
    there = timed_feedbacks(configured(options, channels=channels), 100.0)
    assert sorted(frame.bus for frame in there) == ([] if options else [0, 0, 0, 0, 1, 1])


def test_estimates_sent_by_timer_cost_135_bits_each_and_widen_the_encoder_alarm_limits():
    c, waits, shares = family("odrive"), [], []
    for unasked_ms in (0, 10):
        drives = c.drives.model_copy(update={"options": {"encoder_msg_rate_ms": unasked_ms}})
        made = c.model_copy(update={"drives": drives})
        waits.append(np.array(answered_ns(made)))
        shares.append(encoder_limits(made, c.loop.rate_Hz).unshared)
    assert (waits[1] - waits[0]).tolist() == [135_000], "one of 8 bytes with its stuffing"
    assert shares == [0.3, 0.6]


def test_time_of_the_newest_estimate_bounds_the_time_of_its_poll_from_above():
    """The bus reports the acceptance of frames, slowly: the first estimate may come from the timer."""
    protocol = ready().protocol
    polls = protocol.begin(protocol.start(SETUP._replace(reaction=Reaction.BRAKE)), 0)
    answers = [Received(300_000, estimate(2, 0.0)), Received(700_000, estimate(2, 0.1))]
    given, came = sent_array(polls), received_array(answers)
    sent = checked(protocol.protocol, given, [900_000] * LEGS, came, 0, 0, 900_000, 100_000)
    assert list(sent) == [900_000, 900_000, 600_000, 900_000, 900_000, 900_000]
