"""Legs on several buses: refused configurations, the bus of each frame, and the bus object."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from drivers import build_protocol
from drivers.can.bus import Bus
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.errors import ConfigurationError
from drivers.frame_array import NO_FRAMES, received_array, sent_array
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import BUS, DriveSetup, Frame, Received, off_bus
from drivers.sensing.settings import ImuSettings, SensorSettings
from drivers.sensors import SensorProtocol
from drivers.signals import Command, DriveMode, DriveState, Reaction
from drivers.tick_columns import new_record
from hil.contracts.by_value import ByValue
from hil.contracts.loopback import PERIOD_NS, Ends, shapes
from hil.contracts.messages import Answer, Configure, Sync, hear
from plant_fmu.drives import drives_end
from tests.drivers.cia402_drives import holding
from tests.drivers.fake_links import FakeLink, ManualClock
from tests.drivers.legs_frames import command_frames, opening, parse
from tests.sensor_samples import Readings, encode
from tests.sensor_samples import decode as decode_samples

HALVES = [{"channel": "a", "legs": [0, 1, 2]}, {"channel": "b", "legs": [3, 4, 5]}]
ODD = ((0, 5), (1, 2, 3, 4))
FORCE = np.array([10.0, 11.0, 12.0, 13.0, 14.0, 15.0])
NODES = (1, 2, 3, 4, 5, 6)
GEAR = TransmissionSettings(lead_m=0.02)
PULLEY = TransmissionSettings(pulley_radius_m=0.02)
FAMILIES: dict[str, tuple[str, dict[str, Any], TransmissionSettings | None]] = {
    "legs": ("fd", {}, None),
    "cia402": ("classic", {"rated_torque_Nm": 9.0}, GEAR),
    "damiao": ("classic", {"variant": "damiao", "model": "DM4310"}, PULLEY),
    "robstride": ("classic", {"variant": "robstride", "model": "rs-02"}, PULLEY),
    "odrive": ("classic", {}, GEAR),
    "moteus": ("fd", {"timeout_mode": "stopped", "torque_N_m": 7}, GEAR),
}
SETUP = DriveSetup(0.02, Reaction.BRAKE, 400.0)


def buses(*channels: Mapping[str, object], **shared: object) -> BusSettings:
    return BusSettings.model_validate({"channels": list(channels), **shared})


def family(name, legs=((0, 1, 2), (3, 4, 5))):
    layout, options, gear = FAMILIES[name]
    protocol = {"damiao": "mit", "robstride": "mit"}.get(name, name)
    channels = [{"channel": f"c{k}", "legs": list(there)} for k, there in enumerate(legs)]
    drives = DriveSettings(protocol=protocol, options=options, transmission=gear, force_limit_N=100.0)
    bus = buses(*channels, layout=layout) if len(legs) > 1 else BusSettings(layout=layout)  # type: ignore[arg-type]
    return ByValue(build_protocol(bus, drives))


# configuration


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ([HALVES[0], {"channel": "b", "legs": [2, 3, 4, 5]}], "given twice: 2"),
        ([HALVES[0], {"channel": "b", "legs": [3, 5]}], "missing: 4"),
        ([HALVES[0], {"channel": "a", "legs": [3, 4, 5]}], "given twice: a"),
        ([HALVES[0], {"channel": "b", "legs": [3, 4, 6]}], "less than 6"),
        ([HALVES[0], HALVES[1] | {"layout": "classic"}], "layout of its own.*given: classic"),
    ],
)
def test_assignment_of_legs_to_buses_that_omits_or_repeats_a_leg_is_refused(channels, message):
    with pytest.raises(ValidationError, match=message):
        buses(*channels)
    with pytest.raises(ValidationError, match="both channel and channels"):
        buses(*HALVES, channel="x")


def test_settings_omitted_for_one_bus_are_taken_from_the_common_bus_settings():
    own = {"interface": "socketcan", "bitrate_bit_s": 500_000, "options": {"x": 1}}
    other = {"channel": "b", "legs": [5, 3, 4], **own}
    found = buses(HALVES[0], other, bitrate_bit_s=800_000, max_load_percent=60.0)
    first, second = found.buses
    assert (first.interface, first.channel, first.bitrate_bit_s) == ("localcan", "a", 800_000)
    assert (second.interface, second.channel, second.bitrate_bit_s) == ("socketcan", "b", 500_000)
    assert (second.max_load_percent, first.options, second.options) == (60.0, {}, {"x": 1})
    assert found.legs == ((0, 1, 2), (3, 4, 5))
    assert found.channel == "a", "where the operator finds the run"


def test_sensor_is_received_only_on_its_configured_bus_which_must_exist():
    with pytest.raises(ConfigurationError, match=r"sensors\.imu\.channel: .*given: c"):
        SensorProtocol(buses(*HALVES), SensorSettings(imu=ImuSettings(channel="c")))
    sensors = SensorProtocol(buses(*HALVES), SensorSettings(imu=ImuSettings(channel="b")))
    frame = encode(sensors, "imu", (0.0,) * 6, 7, 0.0, 3)
    assert frame.bus == 1
    before = decode_samples(sensors, NO_FRAMES, 7, Readings())
    for each, count in ((frame, 1), (frame._replace(flags=frame.flags - BUS), 0)):
        assert len(decode_samples(sensors, received_array([Received(0, each)]), 7, before).imu) == count


# where a frame goes


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("legs", [((0, 1, 2), (3, 4, 5)), ODD, tuple((leg,) for leg in range(6))])
def test_all_frames_to_a_drive_are_sent_on_the_bus_of_that_drive(name, legs):
    protocol = family(name, legs)
    on = {leg: bus for bus, there in enumerate(legs) for leg in there}
    tick = new_record()
    tick["tick"], tick["age"], tick["drive_state"] = 0, 0, DriveState.BOOT
    dialogue, command = protocol.command(protocol.start(SETUP), Command(DriveMode.OFF, np.zeros(6)), 0)
    dialogue, configure = protocol.set_up(dialogue, tick)
    opening, stop = protocol.begin(dialogue, 0), protocol.traits.emergency_stop
    for_all = name in ("legs", "cia402")
    assert Counter(frame.bus for frame in opening) == {
        k: 1 if for_all else len(legs[k]) for k in set(on.values())
    }
    assert {frame.bus for frame in stop} == set(on.values())
    single, named = family(name, (tuple(range(6)),)), set()
    for frame in (*opening, *command, *configure, *stop):
        _, messages = single.parse(single.power_up(), off_bus(frame))
        alone = {message.leg for message in messages if isinstance(message, Answer | Configure)}
        for message in messages:
            legs_of = getattr(message, "legs", ())
            alone |= set(legs_of) if len(legs_of) == 1 else set()
        if name == "cia402" and frame.id & 0x780 == 0x200:  # RPDO1 of a node
            alone = {(frame.id & 0x7F) - 1}
        assert {on[leg] for leg in alone} <= {frame.bus}
        named |= alone
    assert named >= ({0} if name == "legs" else set(range(6)))


def answers_of(name: str, protocol: ByValue) -> list[tuple[int, Frame]]:
    """Answers of six drives; CiA 402 drives are set up before."""
    zeros, state, memory = np.zeros(6), np.full(6, DriveState.OFF, np.int64), protocol.power_up()
    if name == "cia402":
        memory = holding(protocol.protocol, state)
    return protocol.answer(memory, Sync(0), zeros + 0.1, zeros, zeros, state)[1]


def decoded(protocol: ByValue, frames: Sequence[Frame]) -> Any:
    last, tick = new_record(), new_record()
    last["tick"], tick["tick"] = -1, 0
    heard = received_array([Received(5, each) for each in frames])
    protocol.decode(protocol.start(SETUP), heard, last, tick, 0)
    return tick


@pytest.mark.parametrize("name", FAMILIES)
def test_answer_of_a_drive_is_accepted_only_on_the_bus_of_that_drive(name):
    protocol = family(name, ODD)
    answers = answers_of(name, protocol)
    assert {leg: frame.bus for leg, frame in answers} == {0: 0, 5: 0, 1: 1, 2: 1, 3: 1, 4: 1}
    assert all(protocol.sender(frame) == leg for leg, frame in answers)
    moved = [frame._replace(flags=frame.flags + (BUS if frame.bus == 0 else -BUS)) for _, frame in answers]
    assert {protocol.sender(frame) for frame in moved} == {-1}
    assert not any(protocol.fresh(Received(5, frame), 0, 0) for frame in moved)
    for frames, strays in (([frame for _, frame in answers], 0), (moved, len(moved))):
        tick = decoded(protocol, frames)
        assert tick["rejected"] == strays
        assert (tick["age"] == 0).sum() in ((0,) if strays else (6,)) or name == "cia402"


def test_config_frame_gives_each_drive_its_position_in_the_command_frame_of_its_bus():
    protocol = LegsProtocol("fd", NODES, 100.0, ODD)
    frames = protocol.configure(0.01, Reaction.BRAKE)
    assert [frame.data[5] for frame in frames] == [1, 1, 2, 3, 4, 2], "legs 0 and 5; legs 1 to 4"
    assert parse(protocol, frames[5]) == Configure(5, 0.01, Reaction.BRAKE)
    assert parse(protocol, frames[5]._replace(flags=frames[5].flags + BUS)) is None


def test_sync_samples_only_the_legs_of_its_bus_and_a_command_without_it_is_refused():
    protocol = LegsProtocol("fd", NODES, 100.0, ((0, 1, 2), (3, 4, 5)))
    first, second = opening(protocol, 4)
    end = drives_end(protocol)
    assert hear(end, second) == (Sync(4, (3, 4, 5)),)
    commands = command_frames(protocol, Command(DriveMode.OFF, np.zeros(6)), 4)
    kinds = [type(hear(end, frame)[0]).__name__ for frame in commands]
    assert kinds == ["Rejected", "DeviceCommand"], "bus 0 has had no SYNC"
    assert hear(end, first) == (Sync(4, (0, 1, 2)),)


HEARTBEAT = 0x700 + 127
"""Heartbeat of a CiA 402 controller: no tick needs it."""


@pytest.mark.parametrize("name", ["legs", "cia402", "odrive", "moteus"])
def test_frames_exchanged_with_running_drives_on_each_bus_are_those_of_the_bus_budget(name):
    ends, run = Ends(family(name, ODD)), Command(DriveMode.RUN, FORCE)
    ends.running(FORCE)
    for _ in range(20):
        ends.step(run, set_up=False)
    protocol, there = ends.protocol, ends.nodes.snapshot()
    assert there.state.tolist() == [DriveState.RUN] * 6
    np.testing.assert_allclose(there.command, protocol.carried(ends.dialogue, FORCE), rtol=0, atol=0.2)
    begun = ends.tick * PERIOD_NS
    answers = [each.frame for each in ends.received if protocol.fresh(each, ends.tick, begun)]
    sent = [frame for frame in ends.sent if frame.id != HEARTBEAT]
    cyclic = protocol.traits.cyclic_frames
    found = shapes((*ends.opening, *sent, *answers), named=True)
    assert found == shapes(cyclic, named=True)
    assert {frame.bus for frame in cyclic} == {0, 1}
    if name in ("legs", "cia402"):
        assert [(frame.id, frame.bus) for frame in cyclic[:2]] == [(0x080, 0), (0x080, 1)]


# the bus object


def test_skew_between_buses_is_measured_at_their_first_frames_of_a_period():
    for times, skew_ns in (
        (((75_000, 900_000), (151_000,), (80_000,)), 76_000),
        (((75_000,), (), (76_000,)), 1_000),
        (((), ()), 0),
    ):
        assert Bus([FakeLink(ManualClock(), ends_ns=each) for each in times]).skew_ns() == skew_ns
    bus = Bus([FakeLink(ManualClock(), ends_ns=each) for each in ((10, 11), (20, 21))])
    order = (1, BUS), (1, 0), (2, BUS), (3, BUS), (2, 0)
    bus.send(sent_array([Frame(identifier, b"", flags) for identifier, flags in order]))
    assert list(bus.sent_ns()) == [20, 10, 21, None, 11], "None: the bus did not accept it"


def test_channel_given_as_a_number_is_read_as_its_name():
    numbered = [{"channel": n, "legs": [n, n + 3]} for n in range(3)]
    assert [each.channel for each in BusSettings.model_validate({"channels": numbered}).buses] == [
        "0",
        "1",
        "2",
    ]
    with pytest.raises(ValueError, match="channel"):
        BusSettings.model_validate({"channel": True})
