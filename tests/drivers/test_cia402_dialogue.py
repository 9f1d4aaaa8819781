"""CiA 402 drives that power up late, reset, trip, refuse, lose the controller or are stopped."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.cia402 import objects as o
from drivers.cia402.states import State, commanded, meaning
from drivers.errors import ConfigurationError, ProtocolError
from drivers.frame_array import received_array
from drivers.protocol import DriveSetup, Frame, Received
from drivers.signals import LEGS, Command, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.by_value import ByValue, Remembered
from hil.contracts.ends import FORCE, LENGTH, OFF, PERIOD_NS, SETUP, Ends, at_tick
from hil.contracts.messages import Answer, DeviceCommand, Status, Sync, UnwatchedCommand
from plant_fmu.drives import cia402_dictionary as dictionary
from plant_fmu.faults.kinds import DriveReset, DriveSilence
from tests.drivers.cia402_drives import (
    PERMILLE_N,
    SCREW_m,
    Slope,
    STEP_m,
    changed,
    difference,
    drives,
    holding,
)

RUN = Command(DriveMode.RUN, FORCE)
READY = Command(DriveMode.READY, FORCE)
RESET = Command(DriveMode.RESET, np.zeros(LEGS))
HEARTBEAT = 0x77F


P = ByValue(drives())


def enabled(**objects: int) -> Remembered:
    """Return drives in Operation Enabled, set to cyclic torque; objects are those of leg 2's."""
    memory = holding(P.protocol, [DriveState.RUN] * LEGS)
    return changed(memory, 2, {o.CONTROLWORD: 0x0F} | {getattr(o, name): n for name, n in objects.items()})


def control(memory: Remembered, word: int, torque: int) -> tuple[Remembered, tuple[Any, ...]]:
    """Return the drives after an RPDO of leg 2's, and what that says."""
    return P.parse(memory, Frame(0x203, struct.pack("<Hh", word, torque)))


def reported(memory: Remembered) -> Remembered:
    """Return the drives when leg 2's has reported its emergency stop."""
    return P.report(memory, Status(2, DriveState.FAULT, DriveFault.ESTOP))[0]


def states(ends: Ends) -> list[int]:
    return list(map(int, ends.measurement["drive_state"]))


def alone(ends: Ends, frames, ticks: int) -> list[Frame]:
    """Let the drives live for some ticks with these frames in each, and return what they send."""
    sent: list[Frame] = []
    for _ in range(ticks):
        ends.tick += 1
        t = ends.tick * PERIOD_NS
        sent += [frame for _, frame in ends.nodes.step(t, [Received(t, f) for f in frames])]
    return sent


@pytest.mark.parametrize(("mode", "torque"), [(None, 0.0), (4, 500.0), (10, 500.0)])
def test_a_drive_without_a_mode_of_operation_gives_no_torque(mode, torque):
    protocol = P
    memory = protocol.power_up()
    _, (booted,) = protocol.report(memory, Status(0, DriveState.BOOT, 0))
    assert booted == Frame(0x701, b"\0")
    memory, _ = protocol.report(memory, Status(0, DriveState.BOOT, 0))
    if mode is not None:
        memory, _ = protocol.parse(memory, Frame(0x601, o.download(o.MODE, mode, 1)))
    memory, _ = protocol.parse(memory, Frame(0x000, b"\x01\x01"))
    memory, _ = protocol.parse(memory, Frame(0x601, o.download(o.TARGET_TORQUE, 500, 2)))
    for word in (0x06, 0x07, 0x0F):
        memory, messages = protocol.parse(memory, Frame(0x601, o.download(o.CONTROLWORD, word, 2)))
    run = [each for each in messages if isinstance(each, DeviceCommand) and each.mode == DriveMode.RUN]
    assert run[0].force[0] == pytest.approx(torque * PERMILLE_N, rel=1e-12)


def test_a_mode_that_comes_by_pdo_is_the_one_that_is_shown():
    protocol = P
    memory, _ = protocol.report(protocol.power_up(), Status(0, DriveState.BOOT, 0))
    mapping = [(0x1400, 1, 0x80000201, 4), (0x1600, 0, 0, 1), (0x1600, 1, 0x60600008, 4), (0x1600, 0, 1, 1)]
    for index, sub, value, size in (*mapping, (0x1400, 1, 0x201, 4)):
        memory, _ = protocol.parse(memory, Frame(0x601, o.download((index, sub), value, size)))
    memory, _ = protocol.parse(memory, Frame(0x000, b"\x01\x01"))
    memory, _ = protocol.parse(memory, Frame(0x201, b"\x0a"))
    _, (answer,) = protocol.parse(memory, Frame(0x601, o.upload(o.MODE_SHOWN)))
    assert isinstance(answer, Answer)
    assert answer.frame.data[4] == 10


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4, 5), (5, 3, 1, 0, 2, 4)])
def test_drives_are_set_up_in_whatever_order_they_power_up(order):
    late = [DriveReset(leg=leg, at_s=0.05 + 0.13 * k) for k, leg in enumerate(order)]
    ends = Ends(drives(), *late)
    for _ in range(400):
        ends.step()
    assert states(ends) == [DriveState.OFF] * LEGS
    assert ends.protocol.set_up_lacks(ends.dialogue) == ("",) * LEGS
    assert ends.nodes._drives.seen.watchdog_ns.tolist() == [50_000_000] * LEGS


def test_drives_that_were_there_before_the_controller_are_found_without_their_boot_up():
    ends = Ends(drives())
    alone(ends, (), 200)
    ends.to_controller.clear()
    ends.until_set_up()


def test_a_drive_that_resets_in_motion_is_in_boot_at_once_and_the_others_run_on():
    ends = Ends(drives(), DriveReset(leg=2, at_s=2.0))
    ends.running()
    while ends.tick * PERIOD_NS < 1_990_000_000:
        ends.step(RUN, set_up=False)
    assert states(ends) == [DriveState.RUN] * LEGS
    for _ in range(12):
        ends.step(RUN, set_up=False)
    assert states(ends) == [3, 3, DriveState.BOOT, 3, 3, 3]
    assert ends.measurement["age"].tolist()[2] > 1
    assert ends.nodes.snapshot().brake.tolist() == [0, 0, 1, 0, 0, 0]
    assert ends.protocol.legs_set_up(ends.dialogue) == (True, True, False, True, True, True)


def test_without_our_heartbeat_each_drive_trips_with_its_emcy_although_pdos_go_on():
    ends = Ends(drives())
    ends.running()
    for _ in range(40):
        ends.step(RUN, set_up=False)
    assert states(ends) == [DriveState.RUN] * LEGS
    pdos = [frame for frame in ends.sent if frame.id != HEARTBEAT]
    sent = alone(ends, pdos, 30)
    for node in range(1, 7):
        assert Frame(0x080 + node, bytes.fromhex("3081110000000000")) in sent
    ends.to_controller = [Received(ends.tick * PERIOD_NS, frame) for frame in sent]
    ends.step(RUN, set_up=False)
    ends.step(RUN, set_up=False)
    assert states(ends) == [DriveState.FAULT] * LEGS
    assert ends.measurement["drive_fault"].tolist() == [0x8130] * LEGS
    assert ends.protocol.fault_text(0x8130) == (
        "EMCY 0x8130, life guard or heartbeat error: the controller's heartbeat was not heard"
    )


def test_heartbeats_alone_keep_a_drive_enabled():
    ends = Ends(drives())
    ends.running()
    alone(ends, [Frame(HEARTBEAT, b"\x05")], 100)
    assert ends.nodes.snapshot().state.tolist() == [DriveState.RUN] * LEGS
    alone(ends, [Frame(HEARTBEAT - 1, b"\x05")], 100)
    assert ends.nodes.snapshot().state.tolist() == [DriveState.FAULT] * LEGS


def test_drives_left_enabled_by_a_dead_daemon_are_braked_and_set_up_by_the_next_after_a_reset():
    ends = Ends(drives())
    ends.running()
    alone(ends, (), 300)
    assert ends.nodes.snapshot().state.tolist() == [DriveState.FAULT] * LEGS
    assert ends.nodes.snapshot().brake.all()
    ends.to_controller.clear()
    ends.dialogue = ends.protocol.start(SETUP)
    ends.step()
    ends.step()
    assert states(ends) == [DriveState.FAULT] * LEGS
    for _ in range(ends.protocol.traits.reset_ticks):
        ends.step(RESET)
    ends.until_set_up()
    for command in (READY, READY, READY, RUN, RUN, RUN):
        ends.step(command)
    assert states(ends) == [DriveState.RUN] * LEGS


def test_another_rated_torque_keeps_the_set_up_from_its_end_and_is_named():
    ends = Ends(drives())
    ends.protocol = ByValue(drives(rated_Nm=10.0))
    ends.dialogue = ends.protocol.start(SETUP)
    for _ in range(150):
        ends.step()
    lacks = ends.protocol.set_up_lacks(ends.dialogue)
    assert lacks == ("0x6076:0 motor rated torque is 9000, expected 10000",) * LEGS
    assert not any(ends.protocol.legs_set_up(ends.dialogue))


@pytest.mark.parametrize(
    ("key", "code", "named"),
    [
        (
            o.FAULT_REACTION,
            o.NO_OBJECT,
            "0x605E:0 fault reaction option code: write refused with abort 0x06020000",
        ),
        (o.MODE, o.BAD_VALUE, "0x6060:0 mode of operation: write refused with abort 0x06090030"),
        ((0x1A00, 2), o.CANNOT_MAP, "0x1A00:2: write refused with abort 0x06040041 (object cannot be mapped"),
    ],
)
def test_an_abort_is_named_with_object_code_and_meaning(monkeypatch, key, code, named):
    honest = dictionary.refused
    monkeypatch.setattr(
        "plant_fmu.drives.cia402_dictionary.refused",
        lambda values, k, v, n: code if k == key else honest(values, k, v, n),
    )
    ends = Ends(drives())
    for _ in range(150):
        ends.step()
    for lack in ends.protocol.set_up_lacks(ends.dialogue):
        assert lack.startswith(named)


def test_a_drive_may_lack_what_is_optional(monkeypatch):
    honest = dictionary.missing
    optional = {0x1029, 0x60C2, 0x1802, 0x1803, 0x6502, 0x608F}
    monkeypatch.setattr(
        "plant_fmu.drives.cia402_dictionary.missing",
        lambda key: o.NO_OBJECT if key[0] in optional else honest(key),
    )
    Ends(drives()).until_set_up()


def test_an_optional_object_that_is_there_and_refuses_its_value_is_a_refusal(monkeypatch):
    honest = dictionary.refused
    monkeypatch.setattr(
        "plant_fmu.drives.cia402_dictionary.refused",
        lambda values, k, v, n: 0x06090030 if k == o.COMMUNICATION_ERROR else honest(values, k, v, n),
    )
    ends = Ends(drives())
    for _ in range(150):
        ends.step()
    for lack in ends.protocol.set_up_lacks(ends.dialogue):
        assert lack.startswith("0x1029:1")
        assert "write refused" in lack


def test_a_value_that_a_drive_does_not_keep_is_found_when_read_back(monkeypatch):
    honest = dictionary.signed
    monkeypatch.setattr(
        "plant_fmu.drives.cia402_dictionary.signed",
        lambda key, value: 40 if key == o.PRODUCER_HEARTBEAT else honest(key, value),
    )
    ends = Ends(drives())
    for _ in range(200):
        ends.step()
    lacks = ends.protocol.set_up_lacks(ends.dialogue)
    assert lacks == ("0x1017:0 producer heartbeat time is 40, expected 24",) * LEGS


def test_a_silent_drive_is_asked_no_more_often_than_its_patience_allows():
    ends = Ends(drives(), DriveSilence(leg=3))
    asked = []
    for _ in range(150):
        asked += [ends.tick for frame in ends.step() if frame.id == 0x604]
    assert min(np.diff(asked)) >= 12
    assert "no answer to" in ends.protocol.set_up_lacks(ends.dialogue)[3]


def test_a_drive_that_leaves_operational_is_set_up_anew():
    ends = Ends(drives())
    ends.until_set_up()
    ends.step(first=[Frame(0x000, b"\x80\x03")])
    for _ in range(8):
        ends.step(set_up=False)
    assert not ends.protocol.legs_set_up(ends.dialogue)[2]
    ends.until_set_up()


def test_an_emergency_stop_with_the_off_of_its_tick_stays_a_stop_until_a_reset():
    ends = Ends(drives())
    ends.running()
    stop = ends.protocol.traits.emergency_stop
    assert {frame.data for frame in stop} == {bytes.fromhex("02000000")}
    ends.step(OFF._replace(stop=True), set_up=False, first=stop)
    for command in (OFF, READY, READY, READY, RUN, RUN, *[OFF] * 30):
        ends.step(command, set_up=False)
        assert states(ends) == [DriveState.FAULT] * LEGS
        assert ends.measurement["drive_fault"].tolist() == [DriveFault.ESTOP] * LEGS
    assert ends.nodes.snapshot().brake.all()
    for _ in range(ends.protocol.traits.reset_ticks):
        ends.step(RESET, set_up=False)
    ends.step(set_up=False)
    assert states(ends) == [DriveState.OFF] * LEGS
    assert not ends.measurement["drive_fault"].any()


@pytest.mark.parametrize(
    ("before", "after"),
    [
        # IEC 61800-7-201, quick stop: transitions 7, 10 and 11
        (State.READY_TO_SWITCH_ON, State.DISABLED),
        (State.SWITCHED_ON, State.DISABLED),
        (State.ENABLED, State.QUICK_STOP),
    ],
)
def test_a_quick_stop_leads_where_the_automaton_has_it(before, after):
    assert commanded(0x02, before, rises=False) == after


@pytest.mark.parametrize(("option", "after"), [(0, State.DISABLED), (2, State.QUICK_STOP)])
def test_a_quick_stop_disables_at_once_where_its_option_code_says_so(option, after):
    memory, _ = control(enabled(QUICK_STOP=option), 0x02, 0)
    assert memory.state[2]["state"] == after


def test_every_quick_stop_is_shown_before_the_drive_is_disabled():
    memory = enabled()
    for _ in range(2):
        memory, _ = control(memory, 0x02, 0)
        memory = reported(memory)
        assert memory.state[2]["state"] == State.QUICK_STOP
        memory = reported(memory)
        assert memory.state[2]["state"] == State.DISABLED
        for word in (0x06, 0x07, 0x0F):
            memory, _ = control(memory, word, 0)
        assert memory.state[2]["state"] == State.ENABLED


def test_the_most_torque_of_a_drive_holds_in_both_directions():
    memory = enabled(MAX_TORQUE=500)
    for torque, given in ((700, 500), (-700, -500), (-400, -400)):
        _, messages = control(memory, 0x0F, torque)
        force = [each.force[0] for each in messages if isinstance(each, UnwatchedCommand)]
        assert force == pytest.approx([given * PERMILLE_N], rel=1e-12)


def test_a_drive_that_was_stopped_gets_no_torque_and_the_others_theirs():
    protocol = P
    dialogue = protocol.start(SETUP)._replace(states=(int(State.ENABLED),) * LEGS, stopped=1 << 2)
    _, frames = protocol.command(dialogue, RUN, 1)
    torques = [int.from_bytes(frame.data[2:4], "little", signed=True) for frame in frames[:LEGS]]
    _, frames = protocol.command(dialogue._replace(stopped=0), RUN, 1)
    sent = [int.from_bytes(frame.data[2:4], "little", signed=True) for frame in frames[:LEGS]]
    assert torques == [0 if leg == 2 else each for leg, each in enumerate(sent)]
    assert sent[2] != 0


def test_a_reset_from_before_the_set_up_reaches_a_drive_once_and_only_in_fault():
    protocol = P
    dialogue = protocol.start(SETUP)
    states = (State.FAULT, State.DISABLED, *[State.FAULT] * 4)
    done = tuple(steps if leg < 3 else 0 for leg, steps in enumerate(dialogue.steps))
    dialogue = dialogue._replace(states=tuple(map(int, states)), at=done, resets=0b111011)
    words = []
    for tick in (1, 2):
        dialogue, frames = protocol.command(dialogue, OFF, tick)
        words.append([int.from_bytes(frame.data[:2], "little") for frame in frames[:LEGS]])
    assert words == [[0x80, 0, 0, 0, 0, 0], [0] * LEGS]
    assert dialogue.resets == 0b111000, "these are not set up yet"


def test_drives_that_rest_are_stopped_too():
    ends = Ends(drives())
    ends.until_set_up()
    ends.step(OFF._replace(stop=True), first=ends.protocol.traits.emergency_stop)
    ends.step()
    assert states(ends) == [DriveState.FAULT] * LEGS


def test_no_force_is_there_before_a_drive_is_enabled_and_then_at_once():
    ends = Ends(drives())
    ends.until_set_up()
    for _ in range(5):
        ends.step(READY, set_up=False)
    assert states(ends) == [DriveState.READY] * LEGS
    assert not ends.nodes.snapshot().force.any()
    assert not ends.measurement["drive_force"].any()
    ends.step(RUN, set_up=False)
    np.testing.assert_allclose(ends.nodes.snapshot().force, FORCE, rtol=0, atol=1.5)


def test_a_drive_is_not_enabled_from_off():
    ends = Ends(drives())
    ends.until_set_up()
    for _ in range(10):
        ends.step(RUN, set_up=False)
    assert states(ends) == [DriveState.OFF] * LEGS


def test_the_slope_of_a_parabola_is_exact_at_its_end():
    t_ns = (0, 2_000_000, 4_000_000, 8_000_000)
    t = [1e-9 * each for each in t_ns]
    x = [1.0 + 0.3 * each - 2.0 * each * each for each in t]
    rate, slope = difference(x[0], t_ns[0], Slope(), 7.0, 2e-3)
    assert (rate, slope.T) == (0.0, 0.0), "one length has no slope"
    _, slope = difference(x[1], t_ns[1], slope, 0.0, 2e-3)
    rate, slope = difference(x[2], t_ns[2], slope, 0.0, 2e-3)
    assert rate == pytest.approx(0.3 - 4.0 * t[2])
    rate, slope = difference(x[3], t_ns[3], slope, 0.0, 2e-3)
    assert rate == pytest.approx(0.3 - 4.0 * t[3])
    assert difference(9.0, t_ns[3] + 990_000, slope, rate, 2e-3) == (rate, slope), "too short a step"
    assert difference(9.0, t_ns[3] + 101_000_000, slope, rate, 2e-3)[0] == 0.0, "too long a one"


@pytest.mark.parametrize("lateness_ns", [(0, 0, 0, 0), (0, 300_000, 0, 200_000)], ids=["in time", "late"])
def test_without_a_velocity_pdo_the_rate_is_that_of_the_lengths(lateness_ns):
    protocol = ByValue(drives(velocity=False))
    dialogue, m = protocol.start(SETUP), at_tick(-1)
    v = np.array([0.1, -0.2, 0.3, -0.4, 0.5, -0.6])
    for number, late_ns in enumerate(lateness_ns):
        state = np.full(LEGS, DriveState.RUN)
        frames = protocol.answer(
            holding(protocol.protocol, state),
            Sync(0),
            LENGTH + v * (number * 4e-3 + 1e-9 * late_ns),
            v,
            FORCE,
            state,
        )[1]
        last, m = m, at_tick(number)
        m["t_ns"], m["lateness_ns"] = number * 4_000_000, late_ns
        dialogue = protocol.decode(dialogue, received_array([Received(0, f) for _, f in frames]), last, m, 0)
    np.testing.assert_allclose(m["rate"], v, rtol=0, atol=2 * STEP_m / 3.7e-3)
    assert {frame.id >> 7 for frame in protocol.traits.cyclic_frames} == {1, 3, 4}


@pytest.mark.parametrize("reaction", [Reaction.HOLD, Reaction.ZERO])
def test_a_reaction_that_such_drives_do_not_have_is_refused(reaction):
    with pytest.raises(ProtocolError, match=r"reactions\.silence.*brake or damp"):
        P.start(SETUP._replace(reaction=reaction))


def test_a_watchdog_of_too_few_periods_is_refused():
    P.start(DriveSetup(0.010, Reaction.BRAKE, 400.0))
    with pytest.raises(ProtocolError, match=r"at least 4 periods are allowed, 0\.01 s"):
        P.start(DriveSetup(0.0099, Reaction.BRAKE, 400.0))


def test_the_heartbeat_comes_four_times_within_the_watchdog_where_the_rate_allows():
    for rate, beat in ((1000.0, 12), (250.0, 3), (100.0, 2)):
        dialogue = P.start(DriveSetup(0.05, Reaction.BRAKE, rate))
        ticks = [n for n in range(60) if P.command(dialogue, OFF, n)[1][-1].id == HEARTBEAT]
        assert set(np.diff(ticks)) == {beat}


def test_node_numbers_are_others_than_the_controllers_own():
    for nodes in ((1, 2, 3, 4, 5, 127), (0, 2, 3, 4, 5, 6)):
        with pytest.raises(ConfigurationError, match=r"drives\.node_ids"):
            drives(nodes)


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0x8130, "heartbeat"),
        (0x2399, "output side"),
        (0x7399, "sensor"),
        (0xFF01, "manual"),
        (0x0999, "unknown"),
    ],
)
def test_an_error_code_has_a_meaning_by_its_row_or_its_class(code, text):
    assert text in meaning(code)


def test_losses_are_made_up_for_while_the_motor_drives_and_saved_while_it_brakes():
    protocol = ByValue(drives(efficiency=0.8, back_driving_efficiency=0.5))
    dialogue = protocol.start(SETUP)._replace(states=(State.ENABLED,) * LEGS, rate=(0.1, 0.1, -0.1, 0, 0, 0))
    force = np.array([1000.0, 1000.0, 1000.0, 1000.0, 0.0, 0.0])
    torques = [
        int.from_bytes(f.data[2:], "little", signed=True)
        for f in protocol.command(dialogue, Command(DriveMode.RUN, force), 1)[1]
    ]
    lossless = 1000.0 * SCREW_m / (2 * np.pi) / 9e-3
    assert torques[:4] == [
        round(lossless / 0.8),
        -round(lossless / 0.8),
        round(lossless * 0.5),
        -round(lossless),
    ]
