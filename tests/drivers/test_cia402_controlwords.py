"""CiA 402: controlword of each state, frames of a command, addressed drives, and settings of the drives."""

from __future__ import annotations

import struct
from math import ceil
from typing import Any

import numpy as np
import pytest

from drivers.cia402.states import State, commanded, controlword
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.protocol import (
    BUS,
    ERROR,
    EXTENDED,
    FD,
    REMOTE,
    REVISION,
    SERIAL,
    DriveSetup,
    Frame,
    Said,
)
from drivers.registry import loaded
from drivers.signals import Command, DriveMode, Reaction
from hil.contracts.by_value import ByValue, Remembered
from hil.contracts.loopback import SETUP
from tests.drivers.cia402_drives import NODES, PERMILLE_N, STEP_m, drives, made, settings
from tests.drivers.motor_families import UNLIKE, UNLIKE_GEAR

OFF, READY, RUN, RESET = DriveMode
P = ByValue(drives())
SIGN = np.array([1, -1, 1, -1, 1, 1])
ALL = (0, 1, 2, 3, 4, 5)
WORDS = {
    # UNHEARD, NOT_READY, DISABLED, READY_TO_SWITCH_ON, SWITCHED_ON, ENABLED, QUICK_STOP, FAULT_REACTION, FAULT
    (OFF, False): (0, 0, 0, 0, 6, 6, 6, 0, 0),
    (READY, False): (0, 0, 6, 7, 7, 7, 0, 0, 0),
    (RUN, False): (0, 0, 0, 0, 15, 15, 0, 0, 0),
    (RESET, False): (0,) * 9,
    (OFF, True): (0, 0, 0, 0, 6, 6, 6, 0, 0),
    (READY, True): (0, 0, 0, 0, 6, 6, 6, 0, 0),
    (RUN, True): (0, 0, 0, 0, 6, 6, 6, 0, 0),
    (RESET, True): (0,) * 9,
}
"""By mode, and whether the drive has had a quick stop."""


@pytest.mark.parametrize(("mode", "stopped"), WORDS)
def test_controlword_follows_from_commanded_mode_and_drive_state(mode, stopped):
    for edge in (False, True):
        found = tuple(controlword(mode, state, edge=edge, stopped=stopped) for state in (-1, *State))
        assert found == ((0x80,) * 9 if edge and mode == RESET else WORDS[mode, stopped])


@pytest.mark.parametrize(
    ("word", "after"),
    [
        (0x00, (0, 1, 1, 1, 1, 1, 6, 7)),
        (0x02, (0, 1, 1, 1, 5, 5, 6, 7)),
        (0x06, (0, 2, 2, 2, 2, 5, 6, 7)),
        (0x07, (0, 1, 3, 3, 3, 5, 6, 7)),
        (0x0F, (0, 1, 4, 4, 4, 5, 6, 7)),
        (0x0D, (0, 1, 1, 1, 1, 1, 6, 7)),
        (0x0B, (0, 1, 1, 1, 5, 5, 6, 7)),
        (0x80, (0, 1, 2, 3, 4, 5, 6, 1)),
        (0x8F, (0, 1, 2, 3, 4, 5, 6, 1)),
    ],
)
def test_controlword_leads_from_each_state_to_the_next_state_of_the_cia402_automaton(word, after):
    assert tuple(map(int, (commanded(word, state, rises=True) for state in State))) == after
    level = tuple(map(int, (commanded(word, state, rises=False) for state in State)))
    assert level == (*after[:7], 7), "only a rising edge clears a fault"


# commands


def begun(**fields: Any) -> Remembered:
    """Dialogue of drives that are set up and enabled."""
    start = P.start(SETUP)
    known: dict[str, Any] = {"at": start.steps, "states": (int(State.ENABLED),) * 6, "mode": RUN}
    return start._replace(**known | fields)


def sent(dialogue: Remembered, command: Command, tick: int = 1, protocol: ByValue = P) -> Any:
    """Dialogue after a command, and controlword and torque of each drive."""
    dialogue, frames = protocol.command(dialogue, command, tick)
    assert [frame.id for frame in frames[:6]] == [0x200 + node for node in NODES]
    return dialogue, [struct.unpack("<Hh", frame.data) for frame in frames[:6]]


PERMILLE = (10, -20, 30, 40, -50, 60)
FORCE = SIGN * PERMILLE_N * np.array(PERMILLE)


def test_commanded_torques_are_sent_in_ready_and_run_and_zero_torque_in_off_and_reset():
    for mode in DriveMode:
        words = {OFF: 6, READY: 7, RUN: 15, RESET: 0}
        _, found = sent(begun(rate=(float("nan"),) * 6), Command(mode, FORCE))
        assert found == [(words[mode], torque if mode in (READY, RUN) else 0) for torque in PERMILLE]


def test_controlword_of_a_reset_has_its_rising_edge_in_even_control_periods():
    assert [sent(begun(), Command(RESET, FORCE), tick)[1][0][0] for tick in (2, 3, 4)] == [0x80, 0, 0x80]


def test_stop_halts_all_drives_without_torque_until_a_reset():
    dialogue, found = sent(begun(), Command(RUN, FORCE, stop=True))
    assert (dialogue.stopped, found) == (0b111111, [(6, 0)] * 6)
    dialogue, found = sent(begun(stopped=0b010010), Command(RUN, FORCE))
    assert found == [(6, 0) if leg in (1, 4) else (15, PERMILLE[leg]) for leg in range(6)]
    assert sent(dialogue, Command(RESET, FORCE))[0].stopped == 0


@pytest.mark.parametrize("leg", range(6))
def test_drive_in_fault_that_missed_a_reset_gets_one_after_its_set_up(leg):
    done = begun().at
    early = begun(at=tuple(3 if k == leg else n for k, n in enumerate(done)), states=(int(State.FAULT),) * 6)
    dialogue, _ = sent(early, Command(RESET, FORCE))
    assert dialogue.resets == 1 << leg
    dialogue, found = sent(dialogue, Command(OFF, FORCE))
    assert (dialogue.resets, found) == (1 << leg, [(0, 0)] * 6)
    for mode, state, word in ((OFF, State.FAULT, 0x80), (RUN, State.FAULT, 0), (OFF, State.DISABLED, 0)):
        later, found = sent(dialogue._replace(at=done, states=(int(state),) * 6), Command(mode, FORCE))
        assert later.resets == 0
        assert [each for each, _ in found] == [word if k == leg else 0 for k in range(6)]


@pytest.mark.parametrize(
    ("watchdog_s", "rate_Hz", "beat"),
    [(0.05, 250.0, 3), (0.016, 250.0, 2), (0.064, 250.0, 4), (0.1, 1000.0, 25), (0.05, 100.0, 2)],
)
def test_controller_heartbeat_is_sent_four_times_per_watchdog_time(watchdog_s, rate_Hz, beat):
    start = P.start(DriveSetup(watchdog_s, Reaction.DAMP, rate_Hz))
    for mode in DriveMode:
        for stop in (False, True):
            found = [P.command(start, Command(mode, np.zeros(6), stop=stop), n)[1][6:] for n in range(60)]
            assert found == [() if n % beat else (Frame(0x77F, b"\5"),) for n in range(60)]


RATE = (0.2, -0.2, 0.2, 0.0, -0.2, 0.05)


@pytest.mark.parametrize(
    ("changes", "shares"),
    [
        ({}, (1.25, 0.5, 0.5, 1.0, 1.25, 1.125)),
        ({"efficiency": 1.0}, (1.0, 0.5, 0.5, 1.0, 1.0, 1.0)),
        ({"back_driving_efficiency": 1.0}, (1.25, 1.0, 1.0, 1.0, 1.25, 1.125)),
    ],
)
def test_torque_command_includes_the_losses_of_each_leg_at_its_last_measured_rate(changes, shares):
    lossy = ByValue(made(NODES, UNLIKE_GEAR.model_copy(update=changes), force_limit_N=100.0))
    force = np.array([100.0, 100.0, -100.0, 100.0, -100.0, 100.0])
    start = lossy.start(SETUP)._replace(rate=RATE, states=(int(State.ENABLED),) * 6)
    expected = np.rint(np.array(shares) * force / UNLIKE.N_per_Nm / 9e-3)
    assert [torque for _, torque in sent(start, Command(RUN, force), 1, lossy)[1]] == expected.tolist()
    carried = lossy.carried(start, force)
    np.testing.assert_allclose(carried, expected * 9e-3 * UNLIKE.N_per_Nm, rtol=1e-12)


# whose a frame is, and what the family is


UNLIKE_NODES = (21, 3, 126, 40, 5, 64)
U = drives(UNLIKE_NODES)


@pytest.mark.parametrize("leg", ALL)
def test_identifier_of_a_frame_gives_its_drive_and_direction_or_all_drives(leg):
    node = UNLIKE_NODES[leg]
    for kind in range(0x080, 0x780, 0x80):
        sends = kind in (0x080, 0x180, 0x280, 0x380, 0x480, 0x580, 0x700)
        assert [U.sender(Frame(kind + n, b"")) for n in (node, 9)] == [leg if sends else -1, -1]
        if kind in (0x200, 0x300, 0x400, 0x500, 0x600):
            assert [U.addressed(Frame(kind + n, b"")) for n in (node, 9)] == [(leg,), ()]
        elif kind in (0x080, 0x180, 0x280, 0x580, 0x700):
            assert U.addressed(Frame(kind + node, b"")) == ALL
    assert [U.addressed(Frame(0, data)) for data in (bytes((1, node)), b"\1\0")] == [(leg,), ALL]
    assert [U.addressed(Frame(0, data)) for data in (b"\1\x09", b"\1", b"")] == [()] * 3
    assert U.addressed(Frame(0x080, b"")) == ALL


@pytest.mark.parametrize("leg", ALL)
def test_only_an_sdo_answer_identifies_its_drive(leg):
    asked = tuple(bytes.fromhex(f"401810{sub:02x}00000000") for sub in (4, 3))
    assert U.traits.identity_requests == tuple(
        tuple(Frame(0x600 + node, data) for node in UNLIKE_NODES) for data in asked
    )
    good = Frame(0x580 + UNLIKE_NODES[leg], bytes.fromhex("4318100478563412"))
    assert U.identity(good) == Said(leg, SERIAL, 0x12345678)
    assert U.identity(good._replace(data=bytes.fromhex("4318100302000100"))) == Said(leg, REVISION, 0x10002)
    texts = "8018100400000206", "6018100400000000", "4318100278563412", "43181004785634", "4118100478563412"
    wrong = [good._replace(data=bytes.fromhex(text)) for text in texts]
    ids = (0x589, *(kind + UNLIKE_NODES[leg] for kind in (0x700, 0x080, 0x600)))
    wrong += [good._replace(id=identifier) for identifier in ids]
    wrong += [good._replace(flags=flags) for flags in (EXTENDED, FD, REMOTE, ERROR, BUS)]
    assert [U.identity(frame) for frame in wrong] == [None] * len(wrong)


def test_frames_of_a_period_are_a_sync_six_rpdos_and_one_or_two_tpdos_per_drive():
    assert P.traits.emergency_stop == tuple(Frame(0x200 + node, b"\2\0\0\0") for node in NODES)
    for velocity, kinds in ((True, [1, *[4] * 6, *[3, 5] * 6]), (False, [1, *[4] * 6, *[3] * 6])):
        assert [frame.id >> 7 for frame in drives(velocity=velocity).traits.cyclic_frames] == kinds


def test_range_of_reported_leg_lengths_is_that_of_32_bit_encoder_counts():
    offset = np.array([0.75] * 5 + [0.5])
    below, above = 2147483648 * STEP_m, 2147483647 * STEP_m
    shortest, longest = P.traits.reported_lengths
    np.testing.assert_allclose(shortest, offset - np.where(SIGN > 0, below, above), rtol=1e-13)
    np.testing.assert_allclose(longest, offset + np.where(SIGN > 0, above, below), rtol=1e-13)


# settings


def configured(
    *, layout: Any = "classic", transmission: Any = settings, options: Any = None, **own: Any
) -> Any:
    known = {"rated_torque_Nm": 9.0} if options is None else options
    gear = transmission() if callable(transmission) else transmission
    section = DriveSettings(protocol="cia402", options=known, transmission=gear, **own)
    return loaded("hil.protocols", "cia402")(BusSettings(layout=layout), section)


def test_each_setting_of_the_drives_is_written_to_its_object_of_the_dictionary():
    own: dict[str, Any] = {
        "node_ids": [9, 8, 7, 6, 5, 4], "heartbeat_ms": 35.0, "watchdog_ms": 20.0, "force_limit_N": 500.0,
    }  # fmt: skip
    protocol = ByValue(configured(**own, options={"rated_torque_Nm": 9.0, "controller_node": 100}))
    start = protocol.start(DriveSetup(0.04, Reaction.BRAKE, 250.0))
    written = [{s.key: s.value for s in plan if s.kind == "write"} for plan in protocol.plans(start.setup)]
    assert [each[0x1017, 0] for each in written] == [35] * 6
    assert [each[0x1016, 1] for each in written] == [100 << 16 | 40] * 6
    assert [each[0x1800, 1] for each in written] == [0x180 + node for node in own["node_ids"]]
    assert [each[0x6072, 0] for each in written] == [ceil(500.0 / PERMILLE_N)] * 6
    assert protocol.command(start, Command(OFF, np.zeros(6)), 0)[1][-1].id == 0x700 + 100
    for heartbeat_ms, set_to in ((0.2, 1), (24.4, 24), (70_000.0, 65_535)):
        steps = made(NODES, UNLIKE_GEAR, heartbeat_ms=heartbeat_ms).plans(SETUP)[0]
        assert [s.value for s in steps if s.key == (0x1017, 0) and s.kind == "write"] == [set_to]
    assert made((1, 2, 3, 4, 5, 127), UNLIKE_GEAR, controller_node=9).nodes == (1, 2, 3, 4, 5, 127)
    for rated_Nm in (1e-3, 4_294_967.0):
        assert configured(options={"rated_torque_Nm": rated_Nm}).rated_torque_mNm == round(1e3 * rated_Nm)
    for checks, asked in ((True, [131072]), (False, [])):
        found = configured(options={"rated_torque_Nm": 9.0, "check_encoder": checks})
        plans = ByValue(found).plans(SETUP)
        assert [[s.value for s in plan if s.key == (0x608F, 1)] for plan in plans] == [asked] * 6


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"layout": "fd"}, r"bus\.layout: .*given: fd"),
        ({"transmission": None}, r"drives\.transmission: "),
        ({"options": {}}, r"rated_torque_Nm of .*given: nothing"),
        *(
            ({"options": {"rated_torque_Nm": 9.0, key: value}}, f"{word} .*given: {value}")
            for word, key, value in (
                ("rated_torque_Nm of", "rated_torque_Nm", 0.000999),
                ("rated_torque_Nm of", "rated_torque_Nm", 4_294_967.5),
                ("velocity of", "velocity", "both"),
                ("controller_node of", "controller_node", 0),
                ("controller_node of", "controller_node", 128),
                (r"node_ids\[2\]:", "controller_node", 3),
                ("check_encoder of", "check_encoder", 1),
            )
        ),
        ({"options": {"rated_torque_Nm": 9.0, "speed": 1}}, r"drives\.options: .*given: speed"),
        *(
            ({"node_ids": [1, 2, node, 4, 5, 6]}, rf"node_ids\[2\]: .*given: {node}")
            for node in (0, 127, 128)
        ),
    ],
)
def test_invalid_setting_of_cia402_drives_is_refused_with_its_key(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        configured(**changes)
