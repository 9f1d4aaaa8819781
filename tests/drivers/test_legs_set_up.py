"""Set-up of the protocol `legs`: when a drive gets a CONFIG, and what confirms it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError, ProtocolError
from drivers.frame_array import received_array
from drivers.legs.messages import set_up_checksum
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import BUS, ERROR, EXTENDED, REMOTE, DriveSetup, Frame, Received
from drivers.signals import Command, DriveFault, DriveMode, DriveState, Reaction
from drivers.tick_columns import Record, new_record
from hil.contracts.by_value import ByValue, Remembered
from hil.contracts.drives_end import reports
from hil.contracts.messages import Configure, Rejected, Status, Sync, hear
from plant_fmu.drives import drives_end
from tests.drivers.legs_frames import command_frames, opening, parse

NODES = (127, 20, 30, 40, 50, 1)
P = LegsProtocol("fd", NODES, 32_000.0)
V = ByValue(P)
SETUP = DriveSetup(0.0125, Reaction.HOLD, 250.0)
BOOT, OFF, READY, RUN, FAULT = DriveState


def placed(*places: int) -> LegsProtocol:
    """The protocol of drives that have these places in the command."""
    protocol = LegsProtocol("fd", NODES, 32_000.0)
    protocol.tables["place"] = places
    return protocol


def status(leg: int, state: int = OFF, protocol: LegsProtocol = P, **other: Any) -> Frame:
    """Status of a drive that has our set-up, or a changed one."""
    holds = Configure(leg, 0.0125, Reaction.HOLD)._replace(**other)
    return reports(protocol, Status(leg, state, DriveFault.NONE, holds))[0]


def bare(leg: int) -> Frame:
    """Status of a drive that was never set up."""
    return reports(P, Status(leg, OFF, DriveFault.NONE))[0]


def taken(dialogue: Remembered, *frames: Frame) -> Remembered:
    tick = new_record()
    tick["tick"] = 1
    return V.decode(dialogue, received_array([Received(5, each) for each in frames]), new_record(), tick)


def at(number: int, age: Any = 0, state: Any = OFF) -> Record:
    tick = new_record()
    tick["tick"], tick["age"], tick["drive_state"] = number, age, state
    return tick


def begun(**fields: Any) -> Remembered:
    return V.start(SETUP)._replace(**fields)


@pytest.mark.parametrize(("rate_Hz", "ticks"), [(50.0, 6), (325.0, 6), (330.0, 7), (400.0, 8), (1000.0, 20)])
def test_each_drive_may_get_a_config_frame_every_20_ms_but_at_least_six_periods_apart(rate_Hz, ticks):
    dialogue = V.start(SETUP._replace(rate_Hz=rate_Hz))
    turns = [[f.id - 0x600 for f in V.set_up(dialogue, at(k, state=BOOT))[1]] for k in range(2 * ticks)]
    assert turns == 2 * ([[node] for node in NODES] + [[]] * (ticks - 6))


@pytest.mark.parametrize("leg", range(6))
def test_drive_state_answer_age_and_number_of_tries_decide_if_a_config_frame_is_sent(leg):
    def sends(state: int, age: int = 0, sent: int = 0, confirmed: int = 0) -> bool:
        states, ages, tries = ([9] * 6 for _ in range(3))
        states[leg], ages[leg], tries[leg] = state, age, sent
        dialogue = begun(sent=tuple(tries), confirmed=confirmed << leg)
        after, frames = V.set_up(dialogue, at(leg + 6, ages, states))
        assert frames in ((), (P.configure(0.0125, Reaction.HOLD)[leg],))
        assert after == dialogue._replace(sent=tuple(9 if k != leg else sent + len(frames) for k in range(6)))
        return bool(frames)

    assert [sends(BOOT, age, 99, 1) for age in (0, 1, 2)] == [True, True, False]
    assert [sends(OFF, 0, sent) for sent in (0, 9, 10)] == [True, True, False]
    assert [sends(OFF, 0, sent, 1) for sent in (0, 1)] == [True, False]
    assert [sends(state) for state in (READY, RUN, FAULT)] == [False, False, True]


@pytest.mark.parametrize("leg", range(6))
def test_status_frame_confirms_or_revokes_the_set_up_of_its_drive(leg):
    mine = 1 << leg
    dialogue = taken(begun(), status(leg))
    assert (dialogue.confirmed, V.legs_set_up(dialogue)) == (mine, (False,) * 6), "we have sent none yet"
    sent = dialogue._replace(sent=(1, 2, 1, 1, 3, 1))
    assert V.legs_set_up(sent) == tuple(k == leg for k in range(6))
    assert [each != -1 for each in dialogue.said] == [k == leg for k in range(6)]
    assert taken(begun(confirmed=63 ^ mine), bare(leg)).said[leg] == 0
    for other in (
        status(leg, BOOT),
        status(leg, watchdog_s=0.013),
        status(leg, reaction=Reaction.DAMP),
        bare(leg),
    ):
        after = taken(begun(confirmed=0b111111), other)
        assert after.confirmed == 0b111111 - mine
        assert after.said[leg] == int.from_bytes(other.data[2:4], "little")


def test_only_the_last_intact_status_frame_of_a_drive_counts():
    first, second = status(2, watchdog_s=0.02), status(2, watchdog_s=0.03)
    heard = taken(begun(), first, second, status(4, watchdog_s=0.02)).said
    assert heard[2] == int.from_bytes(second.data[2:4], "little")
    assert [each == -1 for each in heard] == [True, True, False, True, False, True]
    spoiled = [second._replace(flags=flags) for flags in (EXTENDED, REMOTE, ERROR, BUS)]
    spoiled += [second._replace(data=data) for data in (second.data[:4], bytes(5))]
    spoiled += [second._replace(id=0x702)]
    assert taken(begun(), first, *spoiled).said[2] == int.from_bytes(first.data[2:4], "little")


def test_incomplete_set_up_of_each_drive_is_reported_from_its_checksum():
    statuses = {
        0: status(0),
        2: status(2, reaction=Reaction.DAMP),
        3: status(3, protocol=placed(1, 2, 3, 6, 5, 4)),
        4: bare(4),
        5: status(5, watchdog_s=0.02),
    }
    dialogue = taken(begun(sent=(1, 0, 1, 2, 3, 4)), *statuses.values())
    words = ["", "been sent no CONFIG", "checksum", "checksum", "reports no set-up", "checksum"]
    for leg, (word, lack) in enumerate(zip(words, V.set_up_lacks(dialogue), strict=True)):
        assert (word in lack) if word else not lack
        if word == "checksum":
            found = int.from_bytes(statuses[leg].data[2:4], "little"), dialogue.expected[leg]
            assert "0x{:04X}, not 0x{:04X}".format(*found) in lack
    for unheard in (begun(sent=(1,) * 6), taken(dialogue, status(0, BOOT))):  # the right checksum, in boot
        assert "not confirmed" in V.set_up_lacks(unheard)[0]


def test_drive_with_another_protocol_version_does_not_confirm_its_set_up():
    older = LegsProtocol("fd", NODES, 32_000.0)
    older.tables["version"] = 1
    assert "checksum" in V.set_up_lacks(taken(begun(sent=(1,) * 6), status(1, protocol=older)))[1]


@pytest.mark.parametrize("watchdog_s", [0.0, 4e-7, 4294.9673, float("nan"), float("inf"), -1.0])
def test_watchdog_time_that_rounds_to_0_us_or_exceeds_32_bits_of_us_is_refused(watchdog_s):
    with pytest.raises(ProtocolError, match="CONFIG"):
        P.configure(watchdog_s, Reaction.HOLD)
    for fits in (6e-7, 4294.967295):
        message: Any = parse(P, P.configure(fits, Reaction.HOLD)[2])
        assert message == Configure(2, pytest.approx(max(fits, 1e-6)), Reaction.HOLD)  # type: ignore[arg-type]


# traits


@pytest.mark.parametrize("rated_N", [0.000999, 0.001, 4294967.295, 4294967.296])
def test_rated_force_beyond_the_range_of_the_set_up_checksum_is_refused(rated_N):
    if 0.001 <= rated_N <= 4294967.295:
        assert LegsProtocol("fd", NODES, rated_N).rated_force_N == rated_N
        return
    with pytest.raises(ConfigurationError, match="force_limit_N"):
        LegsProtocol("fd", NODES, rated_N)


# what drives refuse


def test_drives_refuse_a_short_frame_a_repeated_command_and_a_command_of_another_sync():
    command = command_frames(P, Command(DriveMode.RUN, np.zeros(6)), 7)[0]
    sync = opening(P, 7)[0]
    for frame, present in (
        (sync, 7),
        (sync._replace(data=sync.data[:1]), 0),
        (sync._replace(data=b"\7\0"), 0),
        (command._replace(data=command.data[:24]), 7),
        (command, 8),
        (command, -1),
        (P.configure(0.0125, Reaction.HOLD)[2]._replace(data=bytes(9)), 7),
    ):
        end: Any = drives_end(P)
        end.record["present"] = present
        assert hear(end, frame) == (Rejected(),)
        assert end.record["present"].tolist() == [present] * 6
    assert parse(P, sync, 6) == Sync(7)
    newer = LegsProtocol("fd", NODES, 32_000.0)
    newer.tables["version"] = 3
    assert parse(P, newer.configure(0.0125, Reaction.HOLD)[2]) == Rejected()
    assert parse(P, placed(1, 2, 6, 4, 5, 3).configure(0.0125, Reaction.HOLD)[2]) == Rejected()


def test_different_rated_forces_have_different_set_up_checksums():
    frame = P.configure(0.0125, Reaction.HOLD)[2]
    rated_N = (32_000.0, 32_000.001, 31_999.999, 32_000.4, 32_000.5, 32_001.0, 0.001, 0.002)
    assert len({set_up_checksum(frame.id, frame.data[:-1], each) for each in rated_N}) == len(rated_N)
