"""Words of CiA 402 in full: which controlword each state gets, where it leads, and what a command sends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.cia402.states import DRIVE_STATE, STATE_OF, STATUSWORDS, State, commanded, controlword
from drivers.errors import ConfigurationError, ProtocolError
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE, DriveSetup, Frame, Received
from drivers.signals import Command, DriveMode, DriveState, Reaction
from hil.contracts.by_value import ByValue, Remembered
from tests.drivers.cia402_drives import PERMILLE_N, drives, made
from tests.drivers.spoken_drives import UNLIKE, UNLIKE_GEAR

OFF, READY, RUN, RESET = DriveMode
SETUP = DriveSetup(0.05, Reaction.DAMP, 250.0)
P = ByValue(drives())
SIGN = np.array([1, -1, 1, -1, 1, 1])
STATES = (-1, *State)
"""UNHEARD, NOT_READY, DISABLED, READY_TO_SWITCH_ON, SWITCHED_ON, ENABLED, QUICK_STOP, FAULT_REACTION, FAULT."""
WORDS = {
    (OFF, False): (0, 0, 0, 0, 6, 6, 6, 0, 0),
    (READY, False): (0, 0, 6, 7, 7, 7, 0, 0, 0),
    (RUN, False): (0, 0, 0, 0, 15, 15, 0, 0, 0),
    (RESET, False): (0,) * 9,
    (OFF, True): (0, 0, 0, 0, 6, 6, 6, 0, 0),
    (READY, True): (0, 0, 0, 0, 6, 6, 6, 0, 0),
    (RUN, True): (0, 0, 0, 0, 6, 6, 6, 0, 0),
    (RESET, True): (0,) * 9,
}
"""By mode, and whether the drive has been stopped quickly."""


@pytest.mark.parametrize(("mode", "stopped"), WORDS)
def test_each_state_gets_the_controlword_of_its_mode(mode, stopped):
    for edge in (False, True):
        found = tuple(controlword(mode, state, edge=edge, stopped=stopped) for state in STATES)
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
def test_a_controlword_leads_each_state_where_the_automaton_has_it(word, after):
    assert tuple(map(int, (commanded(word, state, rises=True) for state in State))) == after
    level = tuple(map(int, (commanded(word, state, rises=False) for state in State)))
    assert level == (*after[:7], 7), "a fault is cleared at a rising edge alone"


def test_each_statusword_is_its_state_and_its_bits_of_no_state_do_not_count():
    assert {state: hex(word) for state, word in STATUSWORDS.items()} == dict(
        zip(State, ("0x200", "0x250", "0x231", "0x233", "0x237", "0x217", "0x21f", "0x218"), strict=True)
    )
    for state, word in STATUSWORDS.items():
        assert STATE_OF[word & 0x7F] == STATE_OF[(word ^ 0x10) & 0x7F] == state
    assert [STATE_OF[word] for word in (0x01, 0x03, 0x25, 0x2F, 0x6F, 0x28, 0x60, 0x61)] == [
        -1,
        -1,
        -1,
        6,
        -1,
        7,
        1,
        -1,
    ]
    assert len(STATE_OF) == 128
    assert tuple(map(int, DRIVE_STATE)) == (0, 1, 1, 2, 3, 4, 4, 4)


# commands


def begun(**fields: Any) -> Remembered:
    """Return the dialogue of drives that are set up and enabled."""
    start = P.start(SETUP)
    known: dict[str, Any] = {"at": start.steps, "states": (int(State.ENABLED),) * 6, "mode": RUN}
    return start._replace(**known | fields)


def sent(dialogue: Remembered, command: Command, tick: int = 1) -> tuple[Remembered, list[tuple[int, int]]]:
    """Return word and torque of each drive."""
    dialogue, frames = P.command(dialogue, command, tick)
    assert [frame.id for frame in frames[:6]] == [0x200 + node for node in P.nodes]
    data = [frame.data for frame in frames[:6]]
    return dialogue, [
        (int.from_bytes(d[:2], "little"), int.from_bytes(d[2:], "little", signed=True)) for d in data
    ]


FORCE = SIGN * PERMILLE_N * np.array([10, -20, 30, 40, -50, 60])
PERMILLE = (10, -20, 30, 40, -50, 60)


def test_torques_are_sent_in_ready_and_run_and_zero_in_off_and_reset():
    for mode in DriveMode:
        words = {OFF: 6, READY: 7, RUN: 15, RESET: 0}
        _, found = sent(begun(), Command(mode, FORCE))
        assert found == [(words[mode], torque if mode in (READY, RUN) else 0) for torque in PERMILLE]


def test_the_torque_of_a_drive_without_losses_follows_from_the_force_alone():
    assert sent(begun(rate=(float("nan"),) * 6), Command(RUN, FORCE))[1] == [(15, each) for each in PERMILLE]


def test_a_reset_has_its_edge_in_even_ticks():
    assert [sent(begun(), Command(RESET, FORCE), tick)[1][0][0] for tick in (2, 3, 4)] == [0x80, 0, 0x80]


def test_a_stop_halts_all_until_a_reset_and_what_was_stopped_gets_no_torque():
    dialogue, found = sent(begun(), Command(RUN, FORCE, stop=True))
    assert (dialogue.stopped, found) == (0b111111, [(6, 0)] * 6)
    dialogue, found = sent(begun(stopped=0b010010), Command(RUN, FORCE))
    assert found == [(6, 0) if leg in (1, 4) else (15, PERMILLE[leg]) for leg in range(6)]
    assert sent(dialogue, Command(RESET, FORCE))[0].stopped == 0


@pytest.mark.parametrize("leg", range(6))
def test_a_drive_that_could_not_hear_a_reset_gets_one_when_it_is_set_up_and_in_fault(leg):
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


def test_our_heartbeat_follows_the_commands_of_every_few_ticks():
    beats = [len(P.command(begun(), Command(OFF, FORCE), tick)[1]) == 7 for tick in range(7)]
    assert beats == [True, False, False, True, False, False, True]
    assert P.command(begun(), Command(OFF, FORCE), 0)[1][6] == Frame(0x700 + 127, b"\5")
    for watchdog_s, rate_Hz, beat in (
        (0.05, 250.0, 3),
        (0.016, 250.0, 2),
        (0.064, 250.0, 4),
        (0.1, 1000.0, 25),
    ):
        assert P.start(DriveSetup(watchdog_s, Reaction.DAMP, rate_Hz)).beat == beat


@pytest.mark.parametrize("stop", [False, True])
@pytest.mark.parametrize("mode", DriveMode)
def test_our_heartbeat_goes_out_whatever_is_commanded(mode, stop):
    _, frames = P.command(begun(), Command(mode, np.zeros(6), stop=stop), 0)
    assert frames[6:] == (Frame(0x700 + 127, b"\5"),)


@pytest.mark.parametrize(
    "force", [[0.0] * 5, [0.0] * 7, [0.0] * 5 + [float("nan")], [float("inf")] + [0.0] * 5]
)
def test_forces_that_are_not_six_finite_ones_are_refused(force):
    with pytest.raises(
        ProtocolError, match=r"does not fit 0x6071: six of up to 92646\.5 N are allowed; lower"
    ):
        P.command(begun(), Command(RUN, np.array(force)), 1)


def test_the_force_that_fits_is_that_of_the_weakest_leg():
    unlike = ByValue(made((1, 2, 3, 4, 5, 6), UNLIKE_GEAR, force_limit_N=100.0))
    with pytest.raises(ProtocolError, match=r"six of up to 18529\.3 N are allowed"):
        unlike.command(unlike.start(SETUP), Command(RUN, np.full(6, 1e5)), 1)


def test_a_stop_is_a_quick_stop_of_each_drive_and_a_tick_has_a_sync_six_rpdos_and_two_tpdos_a_drive():
    nodes = P.nodes
    assert P.traits.emergency_stop == tuple(Frame(0x200 + node, b"\2\0\0\0") for node in nodes)
    sync, commands, answers = (
        P.traits.cyclic_frames[:1],
        P.traits.cyclic_frames[1:7],
        P.traits.cyclic_frames[7:],
    )
    assert sync == (Frame(0x80, b""),)
    assert commands == tuple(Frame(0x200 + node, bytes(4)) for node in nodes)
    assert [(each.id, len(each.data)) for each in answers] == [
        (first + node, size) for node in nodes for first, size in ((0x180, 8), (0x280, 4))
    ]
    assert P.traits.feedback_ids == {first + node for node in nodes for first in (0x180, 0x280)}
    assert [P.awaited(each) for each in answers] == [each.id for each in answers]


def test_lengths_can_be_reported_that_are_32_bits_of_counts():
    offset = np.array([0.75] * 5 + [0.5])
    below, above = 2147483648 * 0.02 / 131072, 2147483647 * 0.02 / 131072
    shortest, longest = P.traits.reported_lengths
    np.testing.assert_allclose(shortest, offset - np.where(SIGN > 0, below, above), rtol=1e-13)
    np.testing.assert_allclose(longest, offset + np.where(SIGN > 0, above, below), rtol=1e-13)


def test_such_drives_have_their_traits():
    assert (
        P.traits.command_delay_ticks,
        P.traits.set_up_frames,
        P.traits.reset_ticks,
        P.traits.unasked_s,
    ) == (0, 3, 6, 0.0)
    assert (P.traits.database, P.traits.power_told, P.traits.reactions) == (
        None,
        "feedback",
        (Reaction.BRAKE, Reaction.DAMP),
    )
    assert {P.traits.latches_together, P.traits.stop_latches, P.traits.has_watchdog} == {True}
    assert {P.traits.shares_identifiers, P.traits.answers_name_sync, P.traits.force_on_brakes} == {False}


def test_fresh_is_a_tpdo_of_its_length_from_the_beginning_of_the_tick_on():
    good = Frame(0x182, bytes(8))
    assert P.fresh(Received(10, good), 0, 10)
    assert not P.fresh(Received(9, good), 0, 10)
    strange = [good._replace(flags=flags) for flags in (EXTENDED, FD, REMOTE, ERROR)]
    for frame in (*strange, good._replace(data=bytes(7)), good._replace(id=0x187), Frame(0x282, bytes(8))):
        assert not P.fresh(Received(10, frame), 0, 10)


@pytest.mark.parametrize("velocity", [True, False])
def test_a_length_is_off_by_a_count_and_a_rate_by_one_or_by_two_a_period(velocity):
    found = drives(velocity=velocity).traits.resolution.at(250.0)
    count = 0.02 / 131072
    np.testing.assert_allclose(found.length, count, rtol=1e-12)
    np.testing.assert_allclose(found.rate, count if velocity else 500.0 * count, rtol=1e-12)
    np.testing.assert_allclose(found.force, 0.5 * PERMILLE_N, rtol=1e-12)
    assert found.differences is not velocity
    assert len(drives(velocity=velocity).traits.dangers) == (1 if velocity else 2)


def test_losses_are_those_of_each_leg_at_the_rate_last_read():
    lossy = ByValue(made((1, 2, 3, 4, 5, 6), UNLIKE_GEAR, force_limit_N=100.0))
    rate = (0.2, -0.2, 0.2, 0.0, -0.2, 0.05)
    force = np.array([100.0, 100.0, -100.0, 100.0, -100.0, 100.0])
    start = lossy.start(SETUP)._replace(rate=rate, states=(int(State.ENABLED),) * 6)
    _, frames = lossy.command(start, Command(RUN, force), 1)
    shares = np.array([1.25, 0.5, 0.5, 1.0, 1.25, 1.125])
    expected = np.rint(shares * force / UNLIKE.N_per_Nm / 9e-3)
    assert [int.from_bytes(f.data[2:], "little", signed=True) for f in frames[:6]] == expected.tolist()
    carried = lossy.carried(start, force)
    np.testing.assert_allclose(carried, expected * 9e-3 * UNLIKE.N_per_Nm, rtol=1e-12)


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        (
            (1, 2, 0, 4, 5, 6),
            r"node_ids\[2\]: out of range, allowed with cia402: 1 to 127 without the controller's own 9, given: 0",
        ),
        ((1, 2, 128, 4, 5, 6), r"node_ids\[2\]: .* given: 128"),
        ((1, 2, 3, 4, 5, 9), r"node_ids\[5\]: .* given: 9"),
        ((1, 2, 3, 4, 5, 127), None),
    ],
)
def test_drive_nodes_are_1_to_127_except_the_controllers(nodes, message):
    if message is None:
        assert made(nodes, UNLIKE_GEAR, controller_node=9).nodes == nodes
        return
    with pytest.raises(ConfigurationError, match=message):
        made(nodes, UNLIKE_GEAR, controller_node=9)


@pytest.mark.parametrize(("heartbeat_ms", "set_to"), [(0.2, 1), (24.4, 24), (70_000.0, 65_535)])
def test_the_drives_heartbeat_is_whole_milliseconds_of_16_bits(heartbeat_ms, set_to):
    protocol = made((1, 2, 3, 4, 5, 6), UNLIKE_GEAR, heartbeat_ms=heartbeat_ms)
    (step,) = [s for s in protocol.plans(SETUP)[0] if s.key == (0x1017, 0) and s.kind == "write"]
    assert step.value == set_to


def test_a_fault_of_a_drive_is_written_as_the_documents_write_it():
    assert P.fault_text(0x7305) == "EMCY 0x7305, incremental encoder 1 fault"
    assert [int(each) for each in DriveState] == [0, 1, 2, 3, 4]
