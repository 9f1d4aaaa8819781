"""The controller's end of motor drives between measurements: commands, set-up, missing parts, traits."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.config import TransmissionSettings
from drivers.errors import ConfigurationError, ProtocolError
from drivers.motor_settings import refuse_torque
from drivers.protocol import DriveSetup, Frame
from drivers.signals import Command, DriveMode, DriveState, Reaction
from drivers.tick_columns import Record, new_record
from drivers.transmission import Transmission
from tests.drivers.motor_families import MIT_NODES, UNLIKE, begun, measured, mit, moteus

OFF, RUN, FAULT, BOOT = DriveState.OFF, DriveState.RUN, DriveState.FAULT, DriveState.BOOT
P, DAMIAO = moteus(UNLIKE, 2.0), mit("damiao", UNLIKE)
PMAX, VMAX = 21, 22
"""Registers of the third and fourth exchange of a Damiao, with the values 95.5 and 400."""


def answer(leg: int, register: int, value: float) -> Frame:
    """Answer of a Damiao to the read of a register."""
    node = MIT_NODES[leg]
    return Frame(16 + node, struct.pack("<HBBf", node, 0x33, register, value))


def at(number: int, age: Any = 0) -> Record:
    tick = new_record()
    tick["tick"], tick["age"] = number, age
    return tick


def test_watchdog_reaction_that_the_drives_do_not_support_is_refused():
    for reaction in set(Reaction) - {Reaction.DAMP}:
        with pytest.raises(ProtocolError, match=f"reactions.silence {reaction.name.lower()}.* damp"):
            P.start(DriveSetup(0.05, reaction, 250.0))
    for watchdog_s in (1e-9, 100.0):
        P.start(DriveSetup(watchdog_s, Reaction.DAMP, 250.0))


# commands


def test_force_command_is_stored_as_motor_torques_with_losses_at_the_last_rates():
    force, rate = np.array([1.0, -2.0, 3.0, 0.0, 5.0, -6.0]), (0.05, -0.05, 0.2, 0.0, -0.2, 0.01)
    dialogue, frames = P.command(begun(P, rate=rate), Command(DriveMode.READY, force), 3)
    assert (frames, dialogue.mode) == ((), DriveMode.READY)
    assert dialogue.torque == tuple(UNLIKE.torque(force, np.array(rate)).tolist())
    assert dialogue.torque != tuple(UNLIKE.torque(force).tolist())


def test_record_of_enabled_drives_is_cleared_only_by_a_change_of_the_commanded_mode():
    ran = (True, False, True, False, False, True)
    for before in DriveMode:
        for after in DriveMode:
            dialogue, _ = P.command(begun(P, mode=int(before), ran=ran), Command(after, np.zeros(6)), 3)
            assert dialogue.ran == (ran if before == after else (False,) * 6)


@pytest.mark.parametrize("leg", [0, 5])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_force_command_is_accepted_up_to_the_largest_torque_that_the_frame_can_carry(leg, sign):
    force = np.zeros(6)
    most = sign * 2.0 * UNLIKE.N_per_Nm[leg]
    force[leg] = most * (1.0 + 1e-10)
    dialogue, _ = P.command(begun(P), Command(DriveMode.RUN, force), 3)
    assert dialogue.torque[leg] == pytest.approx(sign * 2.0)
    force[leg] = most * (1.0 + 2e-9)
    with pytest.raises(ProtocolError, match=r"up to 2 N m are allowed; lower limits.force_N"):
        P.command(begun(P), Command(DriveMode.RUN, force), 3)
    for wrong in ([1.0] * 5, [1.0] * 5 + [float("nan")], [float("-inf")] + [1.0] * 5, [[1.0] * 6]):
        with pytest.raises(ProtocolError, match="six finite numbers"):
            P.command(begun(P), Command(DriveMode.RUN, np.array(wrong)), 3)


# the start-up dialogue


def test_only_one_drive_per_period_gets_its_next_set_up_request():
    dialogue = begun(DAMIAO, done=(6, 3, 0, 5, 3, 6))
    sent = []
    for number in range(13, 16):
        dialogue, frames = DAMIAO.set_up(dialogue, at(number))
        sent += [(each.data[0], each.data[3]) for each in frames]
    assert sent == [(2, PMAX), (4, 23), (5, PMAX)]
    assert dialogue.asked == (-10, 13, -10, 14, 15, -10)
    assert DAMIAO.set_up(dialogue, at(16)) == (dialogue, ())


def test_drive_that_needs_no_set_up_request_does_not_delay_the_request_to_the_next_drive():
    power = tuple(map(int, (RUN, OFF, OFF, FAULT, OFF, OFF)))
    for asked, node in ((4, 4), (3, 2)):  # before, and after, ten ticks without an answer
        dialogue = begun(DAMIAO, done=(1,) * 6, power=power, asked=(-10, asked, -10, -10, -10, -10))
        # enabled; waiting; silent; silent for one tick
        _, (frame,) = DAMIAO.set_up(dialogue, at(13, [0, 0, 2, 1, 0, 0]))
        assert frame.data[0] == node


def test_answer_with_the_written_value_as_float32_confirms_the_set_up_request():
    before: dict[str, Any] = {"done": (3,) * 6, "asked": (9,) * 6, "read": 4.0, "has_read": 1}
    tick, dialogue = measured(DAMIAO, answer(3, PMAX, 95.5), **before)
    assert dialogue.done == (3, 3, 3, 4, 3, 3)
    assert dialogue.asked == (9, 9, 9, -10, 9, 9)
    assert (dialogue.read, dialogue.has_read) == ((4.0, 4.0, 4.0, 0.0, 4.0, 4.0), (1, 1, 1, 0, 1, 1))
    assert tick["age"].tolist() == [1] * 6, "an answer of the set-up is no feedback"
    assert measured(DAMIAO, answer(3, 23, 144.0), done=(6, 6, 6, 5, 6, 6))[1].done == (6,) * 6
    _, dialogue = measured(DAMIAO, answer(3, PMAX, 95.0), done=(3,) * 6)
    assert (dialogue.done, dialogue.read[3], dialogue.has_read) == ((3,) * 6, 95.0, (0, 0, 0, 1, 0, 0))


@pytest.mark.parametrize(
    ("done", "register"), [(0, PMAX), (2, PMAX), (3, VMAX), (4, PMAX), (6, PMAX), (6, 23)]
)
def test_answer_to_another_request_does_not_advance_the_set_up(done, register):
    for value in (95.5, 400.0, 144.0, 7.0):
        _, dialogue = measured(DAMIAO, answer(3, register, value), done=(done,) * 6)
        assert dialogue == begun(DAMIAO, done=(done,) * 6, owed=(min(done, 1),) * 6)


def test_set_up_report_shows_the_missing_answer_register_or_state_of_each_drive():
    power = tuple(map(int, (OFF, OFF, OFF, OFF, BOOT, RUN)))
    read = {"read": (0.0, 0.0, 0.0, 7.25, 0.0, 1.0), "has_read": (0, 0, 0, 1, 0, 1)}
    dialogue = begun(DAMIAO, done=(0, 1, 3, 3, 6, 6), power=power, **read)
    assert DAMIAO.set_up_lacks(dialogue) == (
        "it has not answered",
        "CTRL_MODE (register 10) is not confirmed",
        "PMAX (register 21) is not confirmed",
        "PMAX (register 21) is 7.25 in the drive, expected 95.5",
        "it has not reported whether it is enabled",
        "",
    )
    assert DAMIAO.legs_set_up(dialogue) == (False,) * 5 + (True,)


@pytest.mark.parametrize("leg", range(6))
def test_force_limit_beyond_the_motor_torque_is_refused_with_the_leg_that_needs_most(leg):
    # F l / (2 pi eta): 100 N x 0.2 m / (2 pi 0.8) = 3.979 N m
    leads = [0.2 if each == leg else 0.1 for each in range(6)]
    unlike = Transmission(TransmissionSettings(lead_m=leads, efficiency=0.8, sign=[1, -1, 1, -1, 1, -1]))
    refuse_torque(unlike, 100.0, 3.98, "kite")
    with pytest.raises(
        ConfigurationError, match=rf"100 N need 3\.979 N m of the motor of leg {leg} .* 3\.97 N m"
    ):
        refuse_torque(unlike, 100.0, 3.97, "kite")
    alike = Transmission(TransmissionSettings(lead_m=0.2, efficiency=0.8))
    with pytest.raises(ConfigurationError, match=r"100 N need 3\.979 N m of the motor \("):
        refuse_torque(alike, 100.0, 3.97, "kite")
