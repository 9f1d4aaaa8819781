"""The controller's end of motor drives between measurements: start, set-up, commands, and what is lacking."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.errors import ProtocolError
from drivers.motor_kernels import ENABLE
from drivers.protocol import DriveSetup, Frame
from drivers.signals import NEVER, Command, DriveFault, DriveMode, DriveState, Reaction
from drivers.tick_columns import Record, new_record
from hil.contracts.messages import Status
from tests.drivers.motor_families import Heard
from tests.drivers.spoken_drives import SETUP, UNLIKE, Spoken
from tests.drivers.test_no_reading import FAMILIES

OFF, RUN, FAULT, BOOT = DriveState.OFF, DriveState.RUN, DriveState.FAULT, DriveState.BOOT


def answer(leg: int, register: int, value: float) -> Heard:
    return Heard(leg, answer=(register, value))


def at(number: int, age: Any = 0) -> Record:
    tick = new_record()
    tick["tick"], tick["age"] = number, age
    return tick


def test_a_word_says_nothing_but_its_leg_where_nothing_else_is_given():
    assert tuple(Heard(2)) == (2, False, False, None, False, None, None, 0, None)


def test_a_dialogue_begins_with_drives_of_which_nothing_is_known_and_asks_at_once():
    dialogue = Spoken().start(SETUP)
    begun = {
        "mode": DriveMode.OFF,
        "torque": (0.0,) * 6,
        "rate": (0.0,) * 6,
        "power": (BOOT,) * 6,
        "ran": (0,) * 6,
        "done": (0,) * 6,
        "asked": (-10,) * 6,
        "has_read": (0,) * 6,
        "said": (0,) * 6,
        "owed": (0,) * 6,
        "patience_ticks": NEVER,
    }
    assert {name: getattr(dialogue, name) for name in begun} == begun


@pytest.mark.parametrize("watchdog_s", [1e-9, 100.0])
def test_a_watchdog_of_more_than_nothing_up_to_100_s_is_taken(watchdog_s):
    assert Spoken().start(DriveSetup(watchdog_s, Reaction.BRAKE, 250.0)).done == (0,) * 6


@pytest.mark.parametrize("watchdog_s", [0.0, -1.0, 100.001, float("nan")])
def test_another_watchdog_is_refused(watchdog_s):
    text = f"drive watchdog of {watchdog_s} s: more than 0 up to 100 s are allowed"
    with pytest.raises(ProtocolError, match=text):
        Spoken().start(DriveSetup(watchdog_s, Reaction.BRAKE, 250.0))


@pytest.mark.parametrize("reaction", [each for each in Reaction if each != Reaction.BRAKE])
def test_a_reaction_that_the_drives_do_not_have_is_refused_with_the_one_that_they_have(reaction):
    text = f"reactions.silence {reaction.name.lower()}: these drives brake by themselves; write that"
    with pytest.raises(ProtocolError, match=text):
        Spoken().start(DriveSetup(0.05, reaction, 250.0))


def test_a_tick_begins_with_the_polls_of_all_drives_in_leg_order():
    protocol = Spoken()
    polls = protocol.begin(protocol.begun(mode=int(DriveMode.RUN)), 3)
    assert polls == tuple(Frame(0x100 + leg, bytes((ENABLE,))) for leg in range(6))


# commands


def test_a_command_is_remembered_as_torques_at_the_rates_last_read_and_sends_nothing():
    protocol, force = Spoken(), np.array([1.0, -2.0, 3.0, 0.0, 5.0, -6.0])
    rate = (0.05, -0.05, 0.2, 0.0, -0.2, 0.01)
    dialogue, frames = protocol.command(protocol.begun(rate=rate), Command(DriveMode.READY, force), 3)
    assert frames == ()
    assert dialogue.mode == DriveMode.READY
    assert dialogue.torque == tuple(UNLIKE.torque(force, np.array(rate)).tolist())
    assert dialogue.torque != tuple(UNLIKE.torque(force).tolist())


def test_which_drives_ran_is_forgotten_with_another_mode_and_with_no_other_command():
    protocol, zeros = Spoken(), np.zeros(6)
    ran = (True, False, True, False, False, True)
    for before in DriveMode:
        for after in DriveMode:
            dialogue, _ = protocol.command(
                protocol.begun(mode=int(before), ran=ran), Command(after, zeros), 3
            )
            assert dialogue.ran == (ran if before == after else (False,) * 6)


@pytest.mark.parametrize("leg", [0, 5])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_force_up_to_the_largest_torque_of_the_field_is_taken_and_one_beyond_is_refused(leg, sign):
    protocol, force = Spoken(), np.zeros(6)
    most = sign * 2.0 * UNLIKE.N_per_Nm[leg]
    force[leg] = most * (1.0 + 1e-10)
    dialogue, _ = protocol.command(protocol.begun(), Command(DriveMode.RUN, force), 3)
    assert dialogue.torque[leg] == pytest.approx(sign * 2.0)
    force[leg] = most * (1.0 + 2e-9)
    with pytest.raises(
        ProtocolError, match=r"\] N needs 2 N m: up to 2 N m are allowed; lower limits.force_N"
    ):
        protocol.command(protocol.begun(), Command(DriveMode.RUN, force), 3)


@pytest.mark.parametrize(
    "force", [[1.0] * 5, [1.0] * 5 + [float("nan")], [float("-inf")] + [1.0] * 5, [[1.0] * 6]]
)
def test_forces_that_are_not_six_finite_ones_are_refused(force):
    with pytest.raises(ProtocolError, match="N: six finite ones are allowed"):
        Spoken().command(Spoken().begun(), Command(DriveMode.RUN, np.array(force)), 3)


def test_what_a_command_carries_is_what_its_torques_give_a_leg_that_does_not_move():
    force, rate = np.array([1.0, -2.0, 3.0, -4.0, 5.0, -6.0]), np.array([0.2, 0.2, -0.2, -0.2, 0.0, 0.05])
    carried = Spoken().carried(Spoken().begun(rate=tuple(rate.tolist())), force)
    # F0 / F at these rates, of an efficiency of 0.8 and 0.5 the other way
    np.testing.assert_allclose(carried / force, [1.25, 0.5, 0.5, 1.25, 1.0, 0.75], rtol=1e-12)


# the start-up dialogue


@pytest.mark.parametrize(("asked", "now"), [(4, False), (3, True)])
def test_a_request_without_an_answer_is_repeated_after_ten_ticks(asked, now):
    protocol = Spoken(exchanges=2)
    dialogue = protocol.begun(done=(3, 3, 3, 2, 3, 3), asked=(0, 0, 0, asked, 0, 0))
    assert bool(protocol.set_up(dialogue, at(13))[1]) == now


def test_each_drive_is_asked_for_the_exchange_that_it_has_not_confirmed_one_drive_a_tick():
    protocol = Spoken(exchanges=2)
    dialogue = protocol.begun(done=(3, 1, 0, 2, 1, 3))
    sent = []
    for number in range(13, 16):
        dialogue, frames = protocol.set_up(dialogue, at(number))
        sent += [each.id for each in frames]
    assert sent == [0x210, 0x231, 0x240]
    assert dialogue.asked == (-10, 13, -10, 14, 15, -10)
    assert protocol.set_up(dialogue, at(16)) == (dialogue, ())


def test_a_drive_that_cannot_be_asked_does_not_hold_up_the_next_one():
    protocol = Spoken(exchanges=1)
    power = tuple(map(int, (RUN, OFF, OFF, FAULT, OFF, OFF)))
    dialogue = protocol.begun(done=(1,) * 6, power=power, asked=(-10, 4, -10, -10, -10, -10))
    ages = [0, 0, 2, 1, 0, 0]  # enabled; asked; silent; one tick silent
    assert protocol.set_up(dialogue, at(13, ages))[1] == (Frame(0x230, b""),)


@pytest.mark.parametrize("mode", DriveMode)
def test_no_drive_is_asked_while_ready_or_run_is(mode):
    protocol = Spoken(exchanges=1)
    _, frames = protocol.set_up(protocol.begun(done=(1,) * 6, mode=int(mode)), at(13))
    assert bool(frames) == (mode in (DriveMode.OFF, DriveMode.RESET))


def test_an_answer_that_is_the_value_as_a_single_confirms_its_exchange_and_the_next_may_be_asked_at_once():
    protocol = Spoken(exchanges=2)
    before: dict[str, Any] = {"done": (1,) * 6, "asked": (9,) * 6, "read": (4.0,) * 6}
    tick, dialogue = protocol.told(answer(3, 10, float(np.float32(30.1))), **before)
    assert dialogue.done == (1, 1, 1, 2, 1, 1)
    assert dialogue.asked == (9, 9, 9, -10, 9, 9)
    assert dialogue.read == (4.0, 4.0, 4.0, None, 4.0, 4.0)
    assert tick["age"].tolist() == [1] * 6, "it is no feedback"
    _, dialogue = protocol.told(answer(3, 11, 31.1), done=(3, 3, 3, 2, 3, 3))
    assert dialogue.done == (3,) * 6


def test_an_answer_of_another_value_is_remembered_and_confirms_nothing():
    _, dialogue = Spoken(exchanges=2).told(answer(3, 10, 30.2), done=(1,) * 6)
    assert (dialogue.done, dialogue.read) == ((1,) * 6, (None, None, None, 30.2, None, None))


@pytest.mark.parametrize(("done", "register"), [(0, 10), (0, 11), (1, 11), (2, 10), (3, 10), (3, 11)])
def test_an_answer_to_nothing_that_was_asked_changes_nothing(done, register):
    protocol = Spoken(exchanges=2)
    for value in (register - 10 + 30.1, 7.0):
        _, dialogue = protocol.told(answer(3, register, value), done=(done,) * 6)
        assert dialogue == protocol.begun(done=(done,) * 6, owed=(min(done, 1),) * 6)


def test_each_drive_lacks_its_answer_its_register_or_what_it_says_of_itself_or_nothing():
    protocol = Spoken(exchanges=2)
    power = tuple(map(int, (OFF, OFF, OFF, OFF, BOOT, RUN)))
    dialogue = protocol.begun(done=(0, 1, 2, 2, 3, 3), power=power, read=(None, None, None, 7.25, None, 1.0))
    assert protocol.set_up_lacks(dialogue) == (
        "it has not answered",
        "register 0 is not confirmed",
        "register 1 is not confirmed",
        "register 1 is 7.25 in the drive, 31.1 here",
        "it has not said whether it is enabled",
        "",
    )
    assert protocol.legs_set_up(dialogue) == (False,) * 5 + (True,)


# what the families are


TRAITS = {
    # command a tick later, frames of set-up a tick, ticks of a reset, stop latches, identifiers shared, watchdog
    "mini_cheetah": (1, 0, 3, False, True, False),
    "cubemars": (1, 0, 3, False, True, False),
    "damiao": (1, 1, 3, False, True, True),
    "robstride": (1, 2, 3, False, True, False),
    "odrive": (0, 0, 3, True, False, True),
    "moteus": (1, 0, 3, False, False, True),
}


@pytest.mark.parametrize("name", FAMILIES)
def test_each_family_has_its_traits(name):
    protocol = FAMILIES[name]
    assert TRAITS[name] == (
        protocol.traits.command_delay_ticks,
        protocol.traits.set_up_frames,
        protocol.traits.reset_ticks,
        protocol.traits.stop_latches,
        protocol.traits.shares_identifiers,
        protocol.traits.has_watchdog,
    )
    assert {
        protocol.traits.force_on_brakes,
        protocol.traits.answers_name_sync,
        protocol.traits.latches_together,
    } == {False}
    assert (protocol.traits.unasked_s, protocol.traits.database) == (0.0, None)
    assert protocol.traits.reactions == ((Reaction.DAMP,) if name == "moteus" else (Reaction.BRAKE,))


def test_answers_that_share_identifiers_are_told_apart_by_their_legs():
    for name in ("mini_cheetah", "cubemars", "damiao", "robstride"):
        protocol = FAMILIES[name]
        assert protocol.traits.feedback_ids == frozenset(range(6))
        assert [protocol.awaited(each) for each in protocol.traits.cyclic_frames] == [-1] * 6 + list(range(6))


def test_turns_without_an_end_name_no_lengths_and_what_a_family_says_of_safety_is_its_brake_and_its_watchdog():
    protocol = Spoken()
    assert protocol.traits.reported_lengths is None
    # a single has 24 bits, and no leg is farther than 2 m from where its drive reads zero
    length, rate, force, differences = protocol.traits.resolution.at(250.0)
    assert (set(length), set(rate), set(force), differences) == ({2.0**-23}, {0.0}, {0.0}, False)
    assert (protocol.traits.power_told, Spoken(reports=False).traits.power_told) == ("feedback", "never")
    brake, watchdog = protocol.traits.dangers
    assert "no frame of these drives works a brake" in brake
    assert watchdog == "nobody watches"
    assert len(FAMILIES["damiao"].traits.dangers) == 1, "its watchdog is set and read back"


@pytest.mark.parametrize("name", [name for name in FAMILIES if name != "odrive"])
def test_drives_that_speak_when_they_are_asked_report_nothing_and_begin_with_nothing_heard(name):
    memory = FAMILIES[name].power_up()
    for state in DriveState:
        assert FAMILIES[name].report(memory, Status(2, state, DriveFault.SENSOR)) == (memory, ())
    assert (memory.heard, memory.enabled) == ((0,) * 6, (0,) * 6)
