"""What CiA 402 drives are asked and told at start-up, and what they and the ticks between say later on."""

from __future__ import annotations

import pytest

from drivers.cia402 import objects as o
from drivers.cia402.end import TRIES
from drivers.cia402.states import State
from drivers.config import BusSettings, DriveSettings
from drivers.frame_array import received_array
from drivers.protocol import DriveSetup, Frame, Received
from drivers.registry import loaded
from drivers.signals import LEGS, NEVER, DriveFault, DriveState, Reaction
from drivers.tick_columns import new_record
from hil.contracts.by_value import ByValue
from hil.contracts.ends import SETUP, Ends
from hil.contracts.messages import EmergencyStop
from plant_fmu.drives.cia402_dictionary import signed
from tests.drivers.cia402_drives import COUNTS, NODES, drives, holding, settings

ON_ITS_OWN = 1 << 30
"""CiA 301: "no RTR allowed on this PDO", bit 30 of a COB-ID."""


def steps(protocol, kind, key, setup=SETUP):
    """Return the values that each drive is asked or told of an object, in order."""
    return [[s.value for s in plan if (s.kind, s.key) == (kind, key)] for plan in protocol.plans(setup)]


@pytest.mark.parametrize(
    ("rate_Hz", "mantissa", "exponent"),
    [
        (2000.0, 50, -5),
        (1000.0, 100, -5),
        (400.0, 250, -5),
        (391.0, 26, -4),  # 2.558 ms, which 255 steps of 10 us are not
        (250.0, 40, -4),
        (100.0, 100, -4),
        (20.0, 50, -3),
        (4.0, 250, -3),
        (4000.0, 25, -5),
        (500_000.0, 1, -5),
        (1000.0 / 255, 255, -3),
        (391.9, 26, -4),
        (0.1, 100, -1),
    ],
)
def test_the_interpolation_period_is_that_of_the_loop(rate_Hz, mantissa, exponent):
    setup = DriveSetup(max(10.0, 4.0 / rate_Hz), Reaction.BRAKE, rate_Hz)
    for kind in ("write", "read"):
        assert steps(drives(), kind, (0x60C2, 1), setup) == [[mantissa]] * LEGS
        assert steps(drives(), kind, (0x60C2, 2), setup) == [[exponent % 256]] * LEGS


@pytest.mark.parametrize("velocity", [True, False])
def test_every_pdo_that_is_not_used_is_switched_off_and_read_back_as_off(velocity):
    protocol = drives(velocity=velocity)
    for n, base in enumerate((0x180, 0x280, 0x380, 0x480)):
        used = n == 0 or (n == 1 and velocity)
        for kind in ("write", "read"):
            last = [values[-1] for values in steps(protocol, kind, (0x1800 + n, 1))]
            ids = [base + node for node in range(1, LEGS + 1)]
            assert last == (ids if used else [1 << 31 | each for each in ids]), (n, kind)


def test_a_drive_that_allows_no_remote_frames_on_its_pdos_is_set_up(monkeypatch):
    seen = []

    def kept(key, raw):
        is_cob = key[1] == 1 and (0x1400 <= key[0] < 0x1600 or 0x1800 <= key[0] < 0x1A00)
        seen.append(is_cob)
        return signed(key, raw) | ON_ITS_OWN * is_cob

    monkeypatch.setattr("plant_fmu.drives.cia402_dictionary.signed", kept)
    Ends(drives()).until_set_up()
    assert any(seen)


@pytest.mark.parametrize("checks", [True, False])
def test_the_counts_of_a_turn_are_read_unless_the_configuration_says_not_to(checks):
    options: dict[str, str | int | float | bool] = {"rated_torque_Nm": 9.0, "check_encoder": checks}
    found = DriveSettings(protocol="cia402", options=options, transmission=settings())
    protocol = loaded("hil.protocols", "cia402")(BusSettings(layout="classic"), found)
    assert steps(protocol, "read", o.ENCODER_INCREMENTS) == [[COUNTS] * checks] * LEGS
    assert steps(protocol, "read", o.MOTOR_REVOLUTIONS) == [[1] * checks] * LEGS


@pytest.mark.parametrize("node", range(LEGS + 1))
def test_an_nmt_stop_takes_the_force_of_every_enabled_drive_that_it_addresses(node):
    protocol = ByValue(drives())
    states = [DriveState.RUN, DriveState.OFF, DriveState.RUN, DriveState.RUN, DriveState.OFF, DriveState.RUN]
    memory = holding(protocol.protocol, states)
    addressed = [leg for leg in range(LEGS) if node in (0, leg + 1)]
    enabled = [leg for leg in addressed if states[leg] == DriveState.RUN]
    memory, messages = protocol.parse(memory, Frame(0x000, bytes((0x02, node))))
    assert messages == tuple(EmergencyStop((leg,)) for leg in enabled)
    stopped = [leg for leg in range(LEGS) if memory.nmt[leg] == o.STOPPED]
    assert stopped == addressed
    quick = [leg for leg in range(LEGS) if memory.state["state"][leg] == State.QUICK_STOP]
    assert quick == enabled
    _, again = protocol.parse(memory, Frame(0x000, bytes((0x02, node))))
    assert again == ()


def decoded(frames, last, number):
    """Return the measurement of a tick after `last`."""
    protocol, tick = ByValue(drives()), new_record()
    tick["tick"] = number
    run = received_array([Received(1, frame) for frame in frames])
    protocol.decode(protocol.start(SETUP), run, last, tick, 0)
    return tick


@pytest.mark.parametrize("leg", range(LEGS))
def test_a_drive_that_was_switched_off_and_on_in_fault_has_lost_its_code_and_the_others_keep_theirs(leg):
    last = new_record()
    last["tick"], last["age"] = 9, 0
    last["drive_state"], last["drive_fault"] = DriveState.FAULT, [0x8130 + k for k in range(LEGS)]
    tick = decoded([Frame(0x701 + leg, b"\0")], last, 10)
    kept = [0x8130 + k for k in range(LEGS)]
    kept[leg] = DriveFault.NONE
    assert tick["drive_fault"].tolist() == kept
    assert [k for k, state in enumerate(tick["drive_state"]) if state == DriveState.BOOT] == [leg]


@pytest.mark.parametrize(("number", "gone"), [(10, 1), (11, 2), (24, 15)])
def test_a_drive_that_is_not_heard_ages_by_the_ticks_that_were_skipped_too(number, gone):
    last = new_record()
    last["tick"], last["age"] = 9, [0, 1, 2, 3, NEVER - 1, NEVER]
    ages = [gone, 1 + gone, 2 + gone, 3 + gone, NEVER, NEVER]
    assert decoded([], last, number)["age"].tolist() == ages


@pytest.mark.parametrize("leg", range(LEGS))
def test_a_drive_that_answers_no_more_is_asked_from_the_beginning_and_the_others_go_on(leg):
    protocol, asked = ByValue(drives()), 900
    dialogue = protocol.start(SETUP)._replace(
        at=(4,) * LEGS,
        asked=tuple(0 if each == leg else asked for each in range(LEGS)),
        tries=tuple(TRIES if each == leg else 1 for each in range(LEGS)),
    )
    tick = new_record()
    tick["tick"] = asked + 1
    after, frames = protocol.set_up(dialogue, tick)
    assert after.at == tuple(0 if each == leg else 4 for each in range(LEGS))
    assert after.tries == (1,) * LEGS
    assert frames == (Frame(0x600 + NODES[leg], protocol.plans(SETUP)[leg][0].request(NODES[leg])),)
