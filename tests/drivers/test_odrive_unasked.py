"""Estimates that an axis sends by a timer, under the identifier of its answers: the newest counts, and none is another axis."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.frame_array import received_array, sent_array
from drivers.protocol import DriveSetup, Frame, Received
from drivers.registry import loaded
from drivers.signals import LEGS, Reaction
from drivers.transmission import Transmission
from hil.app.check.bus import answered_ns
from hil.app.configuration.bus_budget import unasked_readings
from hil.app.encoder_limits import encoder_limits
from hil.contracts.ends import PERIOD_NS, Ends, at_tick
from hil.loop.latches import checked
from tests.drivers.motor_families import ODriveProtocol
from tests.hil.lab.bringup.families import family

NODES = (0, 1, 2, 3, 5, 62)
NONE_AND_SOME = {"encoder_msg_rate_ms": 0}, {"encoder_msg_rate_ms": 10}
GEAR = Transmission(TransmissionSettings(lead_m=0.1, offset_m=1.75))
ESTIMATES = 0x09
UNASKED_S = 0.01


def axes(unasked_s: float = UNASKED_S) -> ODriveProtocol:
    return ODriveProtocol(NODES, 0.05, GEAR, unasked_s=unasked_s)


def ready(unasked_s: float = UNASKED_S) -> Ends:
    ends = Ends(axes(unasked_s))
    ends.until_set_up()
    return ends


def estimate(leg: int, turns: float) -> Frame:
    return Frame(NODES[leg] << 5 | ESTIMATES, struct.pack("<ff", turns, 0.5))


def heard(ends: Ends, *coming: tuple[int, Frame]) -> Any:
    """Return the measurement of the next tick, of frames that came so many ns after its begin."""
    begun = (ends.tick + 1) * PERIOD_NS
    tick = at_tick(ends.tick + 1)
    run = received_array([Received(begun + t_ns, frame) for t_ns, frame in coming])
    ends.protocol.decode(ends.dialogue, run, ends.measurement, tick, begun)
    return tick


ANSWERS = tuple((300_000, estimate(leg, 0.1 * leg)) for leg in range(LEGS))
BEFORE = tuple((-500_000, estimate(leg, 7.0)) for leg in range(LEGS))


@pytest.mark.parametrize("leg", range(LEGS))
def test_the_newest_estimate_of_a_tick_counts_and_two_that_differ_are_no_second_axis(leg):
    tick = heard(ready(), *ANSWERS, (400_000, estimate(leg, 0.9)))
    expected = [0.9 if each == leg else 0.1 * each for each in range(LEGS)]
    np.testing.assert_allclose(tick["length"], 1.75 + 0.1 * np.array(expected), rtol=1e-6)
    assert (tick["doubled"], tick["rejected"], tick["age"].tolist()) == (0, 0, [0] * LEGS)


def test_estimates_from_before_the_poll_are_not_refused_and_measure_nothing_where_the_poll_is_answered():
    tick = heard(ready(), *BEFORE, *ANSWERS)
    np.testing.assert_allclose(tick["length"], 1.75 + 0.01 * np.arange(LEGS), rtol=1e-6)
    assert (tick["doubled"], tick["rejected"], tick["age"].tolist()) == (0, 0, [0] * LEGS)


def test_where_the_axes_are_said_to_send_none_a_second_estimate_and_a_late_one_are_named():
    tick = heard(ready(0.0), BEFORE[0], *ANSWERS, (400_000, estimate(3, 0.9)))
    assert (tick["doubled"], tick["rejected"]) == (1 << 3, 1)


@pytest.mark.parametrize("named", [{}, {"encoder_msg_rate_ms": 10}])
def test_an_axis_is_taken_to_send_its_estimates_every_10_ms_as_delivered(named):
    assert configured(named).traits.unasked_s == pytest.approx(0.01)


def configured(options: dict[str, int], **bus: Any) -> Any:
    values = {"protocol": "odrive", "transmission": {"lead_m": 0.02}, "options": options}
    settings = BusSettings.model_validate({"layout": "classic"} | bus)
    return build_protocol(settings, DriveSettings.model_validate(values))


def test_axes_that_are_set_to_send_none_send_none():
    protocol = loaded("hil.protocols", "odrive")(
        BusSettings(layout="classic"),
        DriveSettings.model_validate(
            {
                "protocol": "odrive",
                "transmission": {"lead_m": 0.02},
                "options": {"encoder_msg_rate_ms": 0},
            }
        ),
    )
    ends = Ends(protocol, setup=DriveSetup(0.05, Reaction.BRAKE, 1e9 / PERIOD_NS))
    for _ in range(20):
        ends.step()
        assert len([f for _, f in ends.received if f.id & 0x1F == ESTIMATES]) == LEGS


@pytest.mark.parametrize("leg", range(LEGS))
def test_an_emulated_axis_sends_its_estimates_every_10_ms_beside_its_answers(leg):
    ends, times = Ends(axes()), list[int]()
    for _ in range(100):
        ends.step()
        polled = ends.tick * PERIOD_NS + 100_000
        own = [t_ns for t_ns, frame in ends.received if frame.id == NODES[leg] << 5 | ESTIMATES]
        assert polled in own
        times += [t_ns for t_ns in own if t_ns != polled]
    assert len(times) > 3
    assert np.abs(np.diff(times) - 1e9 * UNASKED_S).max() <= 1


def test_estimates_that_are_sent_unasked_are_no_polls_that_were_heard():
    ends = Ends(axes())
    for _ in range(20):
        ends.step()
    assert ends.nodes.syncs == 20 * LEGS


@pytest.mark.parametrize(
    ("options", "rate_Hz", "frames"),
    [({}, 312.5, 1), ({}, 200.0, 3), ({}, 100.0, 6), ({}, 50.0, 12), ({"encoder_msg_rate_ms": 0}, 50.0, 0)],
)
def test_estimates_that_no_tick_is_without_are_in_the_arithmetic_of_the_bus(options, rate_Hz, frames):
    found = unasked_readings(configured(options), rate_Hz)
    assert [(len(frame.data), frame.flags) for frame in found] == [(8, 0)] * frames


def test_one_estimate_may_stand_before_the_last_answer_of_a_tick():
    """Of 8 bytes, at most 135 bit with its stuffing; the window has to have room for it."""
    c = family("odrive")
    asked, unasked = (
        answered_ns(c.model_copy(update={"drives": c.drives.model_copy(update={"options": options})}))
        for options in NONE_AND_SOME
    )
    assert [more - fewer for more, fewer in zip(unasked, asked, strict=True)] == [135_000]


def test_on_several_buses_each_carries_the_estimates_of_its_own_axes():
    channels = [{"channel": "a", "legs": [0, 1, 2, 3]}, {"channel": "b", "legs": [4, 5]}]
    found = unasked_readings(configured({}, channels=channels), 100.0)
    assert sorted(frame.bus for frame in found) == [0, 0, 0, 0, 1, 1]


def test_the_estimate_that_counts_says_by_when_its_poll_was_out():
    """A bus that says when it had taken the frames, slowly: what came first may have come by the timer."""
    protocol = axes()
    polls = protocol.begin(protocol.start(DriveSetup(0.05, Reaction.BRAKE, 100.0)), 0)
    answers = [Received(300_000, estimate(2, 0.0)), Received(700_000, estimate(2, 0.1))]
    given, heard = sent_array(polls), received_array(answers)
    sent = checked(protocol.protocol, given, [900_000] * LEGS, heard, 0, 0, 900_000, 100_000)
    assert list(sent) == [900_000, 900_000, 600_000, 900_000, 900_000, 900_000]


@pytest.mark.parametrize(("unasked_ms", "share"), [(10, 0.6), (0, 0.3)])
def test_a_length_that_may_have_come_by_the_timer_may_be_off_by_more_of_its_way(unasked_ms, share):
    c = family("odrive")
    drives = c.drives.model_copy(update={"options": {"encoder_msg_rate_ms": unasked_ms}})
    limits = encoder_limits(c.model_copy(update={"drives": drives}), c.loop.rate_Hz)
    assert limits.unshared == share
