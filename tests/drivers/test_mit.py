"""MIT framing: the contract of each variant, and bytes that other people's code made."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.arrays import Array
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.errors import ConfigurationError
from drivers.frame_array import NO_FRAMES, received_array
from drivers.mit.fields import TURN, VARIANTS, Ranges
from drivers.mit.protocol import ENABLE
from drivers.protocol import EXTENDED, DriveSetup, Frame, Received
from drivers.registry import loaded
from drivers.signals import Command, DriveFault, DriveMode, DriveState, Foreign, Reaction
from drivers.transmission import Transmission
from hil.contracts.by_value import ByValue
from hil.contracts.drives_end import answers
from hil.contracts.ends import PERIOD_NS, Ends, Given, at_tick
from hil.contracts.messages import Sync
from hil.contracts.trouble import TroubleContract
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.mit import device_motion
from plant_fmu.drives.nodes import Nodes
from tests.drivers.motor_families import (
    Heard,
    MitProtocol,
    RobStrideProtocol,
    pack_command,
    read_reply,
    unpack_command,
)

DATA = Path(__file__).parents[1] / "data" / "drives"
SETUP = DriveSetup(0.05, Reaction.BRAKE, 250.0)
WIDE = Ranges(95.5, 400.0, 144.0)
"""Wide enough for the contract's legs of 1.5 to 2 m and 6 kN, behind a lead of 0.1 m."""
LEAD_m, NEWTONS = 0.1, 2 * np.pi / 0.1
GEAR = Transmission(TransmissionSettings(lead_m=LEAD_m, sign=[1, -1, 1, -1, 1, -1], offset_m=1.75))
# Twice a step, because the codecs truncate.
STEP_m, STEP_m_s = 2 * 191.0 / 65535 / (2 * np.pi) * LEAD_m, 2 * 800.0 / 4095 / (2 * np.pi) * LEAD_m
STEP_N = 2 * 288.0 / 4095 * NEWTONS
FINE_m_s, FINE_N = 2 * 800.0 / 65535 / (2 * np.pi) * LEAD_m, 2 * 288.0 / 65535 * NEWTONS
NODES = (1, 2, 3, 4, 5, 15)


class MitInTrouble(TroubleContract):
    LENGTHS, SPEED = (0.24, 3.26), 6.36
    """95.5 rad and 400 rad/s behind 0.1 m a turn, less than a step from the ends."""


class TestMiniCheetah(MitInTrouble):
    RESOLUTION = (STEP_m, STEP_m_s, STEP_N, STEP_N)
    SETS_WATCHDOG = TELLS_BOOT = WATCHED = TELLS_FAULTS = False
    RESTART, WRAPS = "nothing", True

    @pytest.fixture
    def family(self):
        return MitProtocol("mini_cheetah", WIDE, NODES, 0, GEAR)


class TestCubeMars(MitInTrouble):
    RESOLUTION = (STEP_m, STEP_m_s, STEP_N, STEP_N)
    SETS_WATCHDOG = TELLS_BOOT = WATCHED = CLEARS = False
    RESTART = "nothing"

    @pytest.fixture
    def family(self):
        return MitProtocol("cubemars", WIDE, NODES, 0, GEAR)


class TestDamiao(MitInTrouble):
    RESOLUTION = (STEP_m, STEP_m_s, STEP_N, STEP_N)
    TELLS_BOOT = False

    @pytest.fixture
    def family(self):
        return MitProtocol("damiao", WIDE, NODES, 16, GEAR)


class TestRobStride(MitInTrouble):
    RESOLUTION = (STEP_m, FINE_m_s, FINE_N, FINE_N)
    SETS_WATCHDOG = TELLS_BOOT = WATCHED = False

    @pytest.fixture
    def family(self):
        return RobStrideProtocol(WIDE, (1, 2, 3, 4, 5, 127), 253, GEAR)


# -- the dialogue of all variants ----------------------------------------------------------------------


def in_dialogue(**changes: Any) -> tuple[MitProtocol, Any]:
    """Return a Damiao codec, and its dialogue with some changes."""
    protocol = MitProtocol("damiao", WIDE, NODES, 16, GEAR)
    return protocol, protocol.start(SETUP)._replace(**changes)


def test_a_run_that_is_asked_for_anew_enables_anew_though_nothing_was_heard_between():
    off = (int(DriveState.OFF),) * 6
    protocol, dialogue = in_dialogue(mode=DriveMode.RUN, ran=(True,) * 6, power=off)
    torques = {frame.data for frame in protocol.begin(dialogue, 1)}
    assert ENABLE not in torques, "it has been enabled, and fell back by itself"
    for mode in (DriveMode.OFF, DriveMode.RUN):
        dialogue, _ = protocol.command(dialogue, Command(mode, np.zeros(6)), 1)
    assert {frame.data for frame in protocol.begin(dialogue, 2)} == {ENABLE}


@pytest.mark.parametrize(
    ("mode", "asks"), [(DriveMode.OFF, True), (DriveMode.READY, False), (DriveMode.RUN, False)]
)
def test_a_drive_is_not_set_up_while_it_is_to_hold_or_to_run(mode, asks):
    off = (int(DriveState.OFF),) * 6
    protocol, dialogue = in_dialogue(mode=mode, power=off, done=(6, 6, 3, 6, 6, 6))
    tick = at_tick(100)
    tick["age"] = 0
    _, frames = protocol.set_up(dialogue, tick)
    assert bool(frames) == asks
    assert all(frame.data[0] == NODES[2] for frame in frames)


def test_a_request_that_is_not_answered_waits_its_time_whatever_the_others_are_at():
    off = (int(DriveState.OFF),) * 6
    protocol, dialogue = in_dialogue(power=off, done=(6, 6, 3, 6, 6, 6))
    asked = []
    for number in range(100, 131):
        tick = at_tick(number)
        tick["age"] = 0
        dialogue, frames = protocol.set_up(dialogue, tick)
        asked += [number] * len(frames)
    assert asked == [100, 110, 120, 130]


# -- bytes that other people's code made ---------------------------------------------------------------


def vectors(name: str, begins: str) -> list[dict[str, Any]]:
    """Return the vectors of tests/data/drives whose `what` begins so; the file names its sources."""
    found = [each for each in _read(name)["vectors"] if each["what"].startswith(begins)]
    assert found
    return found


def _read(name: str) -> Any:
    return json.loads((DATA / f"{name}.json").read_text(encoding="utf-8"))


def five(inputs: dict[str, Any]) -> list[float]:
    return [inputs[key] for key in ("position_rad", "velocity_rad_s", "kp", "kd", "torque_Nm")]


def ranges(values: list[float]) -> Ranges:
    """Return them from position, velocity, kp, kd, torque, or without gains."""
    p, v, *gains, t = values
    assert gains in ([], [500.0, 5.0])
    return Ranges(p, v, t)


@pytest.mark.parametrize("vector", vectors("mit", "command: "), ids=lambda v: v["what"])
def test_commands_are_those_of_two_libraries_and_decode_as_in_the_firmware(vector):
    r = ranges(_read("mit")["ranges"][vector["inputs"]["range"]])
    p, v, kp, kd, torque = five(vector["inputs"])
    assert pack_command(p, v, kp, kd, torque, r).hex() == vector["data"]
    if "katz" in vector:  # float32
        np.testing.assert_allclose(
            unpack_command(bytes.fromhex(vector["data"]), r), vector["katz"], rtol=2e-5, atol=1e-5
        )


@pytest.mark.parametrize("vector", vectors("mit", "reply"), ids=lambda v: v["what"])
def test_replies_are_read_as_two_libraries_read_them(vector):
    r = ranges(_read("mit")["ranges"][vector["inputs"]["range"]])
    said, data = vector["decoded"], bytes.fromhex(vector["data"])
    names = "position_rad", "velocity_rad_s", "torque_or_current"
    np.testing.assert_allclose(read_reply(data[1:6], r), [said[name] for name in names], rtol=3e-5, atol=1e-8)


@pytest.mark.parametrize(
    "vector",
    [v for v in vectors("mit", "reply") if v.get("made_by") == "KATZ"],
    ids=lambda v: v["what"],
)
def test_the_emulated_drive_packs_replies_as_the_firmware_does_past_its_range_too(vector):
    inputs = vector["inputs"]
    r = ranges(_read("mit")["ranges"][inputs["range"]])
    p, v, torque = (inputs[key] for key in ("position_rad", "velocity_rad_s", "torque_Nm"))
    assert bytes(device_motion(p, v, torque, r, clamps=False)).hex() == vector["data"][2:12]


@pytest.mark.parametrize("vector", vectors("damiao", "MIT command"), ids=lambda v: v["what"])
def test_damiao_commands_are_those_of_its_libraries(vector):
    table = _read("damiao")["ranges"]
    p, v, kp, kd, torque = five(vector["inputs"])
    data = pack_command(p, v, kp, kd, torque, ranges(table[vector["inputs"]["motor"]]))
    assert data.hex() == vector["data"]


@pytest.mark.parametrize("model", ["DM4310", "DM8009", "DM4340", "DM6006", "DM4310_48V", "DM3507"])
def test_the_ranges_of_the_table_are_those_of_two_libraries_or_more(model):
    assert VARIANTS["damiao"].models[model] == ranges(_read("damiao")["ranges"][model])


def damiao(motor: str = "DM4310") -> MitProtocol:
    r = ranges(_read("damiao")["ranges"][motor])
    return MitProtocol("damiao", r, (1, 2, 3, 4, 5, 6), 16, GEAR)


def test_damiao_special_frames_and_registers_are_those_of_its_libraries():
    protocol = damiao()
    start = protocol.start(SETUP)
    off = protocol.poll(start, 4)
    on = protocol.poll(start._replace(mode=DriveMode.RUN), 4)
    clear = protocol.poll(start._replace(mode=DriveMode.RESET, power=(DriveState.FAULT,) * 6), 4)
    for frame, what in ((off, "disable"), (on, "enable"), (clear, "clear error")):
        (vector,) = vectors("damiao", what)
        assert (frame.id, frame.data.hex(), frame.flags) == (vector["id"], vector["data"], 0)
    asked = {exchange.name.split()[0]: exchange.frames[0] for exchange in protocol.exchanges(SETUP)[4]}
    for what, name in (
        ("write parameter CTRL_MODE", "CTRL_MODE"),
        ("read parameter PMAX", "PMAX"),
        ("read parameter TMAX", "TMAX"),
    ):
        vector = vectors("damiao", what)[0]
        assert (asked[name].id, asked[name].data.hex()) == (vector["id"], vector["data"])
    # 0.1 s are 2000 steps of 50 us
    slow = protocol.exchanges(SETUP._replace(watchdog_s=0.1))[4]
    (vector,) = vectors("damiao", "write parameter TIMEOUT")
    assert slow[1].frames[0].data.hex() == vector["data"]


@pytest.mark.parametrize("vector", vectors("damiao", "feedback "), ids=lambda v: v["what"])
def test_damiao_feedback_is_read_with_its_status(vector):
    protocol = damiao(vector["inputs"]["motor"])
    heard = protocol.hear(Frame(vector["id"], bytes.fromhex(vector["data"])))
    said = vector["decoded"]
    assert heard is not None
    assert heard.leg == 4
    code = said["status_code"]
    state = DriveState.OFF if code == 0 else DriveState.RUN if code == 1 else DriveState.FAULT
    assert heard.power == state
    assert heard.torque == pytest.approx(said["torque_Nm"], rel=3e-5)
    if abs(said["position_rad"]) == 12.5:
        assert heard.motion is None, "at its end a position may have gone past it"
    else:
        position, speed = said["position_rad"] / (2 * np.pi), said["velocity_rad_s"] / (2 * np.pi)
        assert heard.motion is not None
        np.testing.assert_allclose(heard.motion, (position, speed), rtol=3e-5)
    if code == 13:
        assert heard.fault == DriveFault.WATCHDOG
    elif code > 1:
        assert protocol.fault_text(heard.fault)


def running(protocol: MitProtocol, leg: int) -> Frame:
    """Return what a running drive at rest answers."""
    zeros, run = np.zeros(6), np.full(6, DriveState.RUN)
    return dict(answers(protocol, Sync(0), protocol.transmission.length(zeros), zeros, zeros, run))[leg]


@pytest.mark.parametrize(("code", "words"), [(1, "motor over temperature"), (6, "phase current unbalance")])
def test_a_cubemars_reply_with_a_code_is_of_a_drive_in_fault(code, words):
    protocol: Any = MitProtocol("cubemars", WIDE, NODES, 0, GEAR)
    good = running(protocol, 4)
    bad = protocol.hear(good._replace(data=good.data[:7] + bytes((code,))))
    assert protocol.hear(good).power != DriveState.FAULT
    assert (bad.leg, bad.power, protocol.fault_text(bad.fault)) == (4, DriveState.FAULT, words)


def test_a_damiao_reply_that_names_another_motor_than_its_identifier_is_broken():
    protocol: Any = damiao()
    frame = running(protocol, 2)
    assert not protocol.hear(frame).broken
    assert protocol.hear(frame._replace(data=bytes((frame.data[0] ^ 1,)) + frame.data[1:])).broken


def test_a_damiao_reply_with_a_status_that_there_is_not_is_broken():
    protocol: Any = damiao()
    frame = running(protocol, 2)
    replies = [
        frame._replace(data=bytes((code << 4 | frame.data[0] & 0xF,)) + frame.data[1:]) for code in range(16)
    ]
    assert [code for code, reply in enumerate(replies) if protocol.hear(reply).broken] == [
        2,
        3,
        4,
        5,
        6,
        7,
        15,
    ]


@pytest.mark.parametrize("vector", vectors("damiao", "parameter reply"), ids=lambda v: v["what"])
def test_damiao_registers_are_read(vector):
    heard = damiao().hear(Frame(vector["id"], bytes.fromhex(vector["data"])))
    assert heard is not None
    if vector["inputs"]["rid"] == 5:
        assert heard == Heard(4), "a register that nobody here asks for, and no feedback"
    else:
        assert heard.answer == (vector["inputs"]["rid"], vector["decoded"]["value"])


def robstride(model: str) -> RobStrideProtocol:
    p, v, torque, _, _ = _read("robstride")["ranges"][model]
    return RobStrideProtocol(Ranges(p, v, torque), (1, 2, 3, 4, 5, 127), 253, GEAR)


@pytest.mark.parametrize(
    "vector", vectors("robstride", "type 1 operation control torque only"), ids=lambda v: v["what"]
)
def test_robstride_commands_are_its_librarys_but_for_the_step_by_which_that_one_is_off(vector):
    protocol = robstride(vector["inputs"]["model"])
    dialogue = protocol.start(SETUP)._replace(
        mode=DriveMode.RUN, ran=(True,) * 6, torque=(vector["inputs"]["torque_Nm"],) * 6
    )
    frame = protocol.poll(dialogue, 0)
    assert frame.flags == EXTENDED
    assert frame.data.hex() == vector["data"]
    assert frame.id & 0xFF0000FF == vector["id"] & 0xFF0000FF
    assert 0 <= (frame.id >> 8 & 0xFFFF) - (vector["id"] >> 8 & 0xFFFF) <= 1


def test_robstride_special_frames_are_those_of_its_libraries():
    protocol = robstride("rs-02")
    start = protocol.start(SETUP)
    on = protocol.poll(start._replace(mode=DriveMode.RUN), 0)
    written, read = protocol.exchanges(SETUP)[0][0].frames
    for frame, what in (
        (on, "type 3 enable"),
        (protocol.poll(start, 0), "type 4 disable"),
        (written, "type 18 write parameter run_mode 0"),
        (read, "type 17 read parameter run_mode"),
    ):
        (vector,) = vectors("robstride", what)
        assert (frame.id, frame.data.hex(), frame.flags) == (vector["id"], vector["data"], EXTENDED)
    (vector,) = vectors("robstride", "type 17 reply run_mode")
    heard = protocol.hear(Frame(vector["id"], bytes.fromhex(vector["data"]), EXTENDED))
    assert heard is not None
    assert heard.answer == (0x7005, 2.0)


@pytest.mark.parametrize("vector", vectors("robstride", "type 2 feedback"), ids=lambda v: v["what"])
def test_robstride_feedback_is_read_as_by_the_library_that_keeps_the_makers_scale(vector):
    heard = robstride("rs-02").hear(Frame(vector["id"], bytes.fromhex(vector["data"]), EXTENDED))
    said = vector["others"]["RS"] if "others" in vector else vector["decoded"]
    faults, mode = vector["inputs"]["fault_bits"], vector["inputs"]["mode_bits"]
    assert heard is not None
    assert heard.leg == 0
    assert heard.power == (DriveState.FAULT if faults else DriveState.RUN if mode == 2 else DriveState.OFF)
    assert heard.fault == (0x100 + faults if faults else 0)
    assert heard.torque == pytest.approx(said["torque_Nm"], rel=1e-5)
    if heard.motion is not None:
        assert heard.motion[0] * 2 * np.pi == pytest.approx(said["position_rad"], rel=1e-5)
        assert heard.motion[1] * 2 * np.pi == pytest.approx(said["velocity_rad_s"], rel=1e-5)
    else:
        assert abs(said["position_rad"]) == pytest.approx(4 * np.pi, rel=1e-6)


# -- what the drives do ---------------------------------------------------------------------------------


@given(torque=st.floats(-20.0, 20.0), position=st.floats(-15.0, 15.0))
def test_a_command_saturates_and_no_torque_makes_it_a_special_frame(torque, position):
    r = VARIANTS["damiao"].models["DM4310"]
    p, v, kp, kd, t = unpack_command(pack_command(position, 0.0, 0.0, 0.0, torque, r), r)
    assert 0.0 <= min(max(torque, -10.0), 10.0) - t < 20.0 / 4095 * (1 + 1e-9)
    assert 0.0 <= min(max(position, -12.5), 12.5) - p < 25.0 / 65535 * (1 + 1e-9)
    assert abs(v) <= 60.0 / 4095
    assert (kp, kd) == (0.0, 0.0)
    protocol = damiao()
    dialogue = protocol.start(SETUP)._replace(mode=DriveMode.RUN, ran=(True,) * 6, torque=(torque,) * 6)
    assert protocol.poll(dialogue, 0).data[:7] != b"\xff" * 7


def run_protocols() -> list[Any]:
    return [
        pytest.param(lambda: MitProtocol("damiao", WIDE, NODES, 16, GEAR), DriveFault.WATCHDOG, id="damiao"),
        pytest.param(lambda: RobStrideProtocol(WIDE, (1, 2, 3, 4, 5, 127), 253, GEAR), None, id="robstride"),
    ]


@pytest.mark.parametrize(("make", "fault"), run_protocols())
def test_a_drive_that_is_left_enabled_by_a_dead_controller_stops_by_itself_where_it_has_a_watchdog(
    make, fault
):
    ends = Ends(make())
    ends.running()
    for _ in range(40):  # 160 ms of silence, 50 ms are allowed
        ends.tick += 1
        ends._to_drives(ends.tick * PERIOD_NS, ())
    snapshot = ends.nodes.snapshot()
    if fault is None:
        assert snapshot.state.tolist() == [DriveState.RUN] * 6, "it goes on"
        return
    assert snapshot.state.tolist() == [DriveState.FAULT] * 6
    assert snapshot.brake.all()
    ends.step(Command(DriveMode.OFF, np.zeros(6)))
    ends.step(Command(DriveMode.OFF, np.zeros(6)))
    assert ends.measurement["drive_fault"].tolist() == [fault] * 6
    for _ in range(ends.protocol.traits.reset_ticks):
        ends.step(Command(DriveMode.RESET, np.zeros(6)))
    for _ in range(3):
        ends.step()
    assert ends.measurement["drive_state"].tolist() == [DriveState.OFF] * 6


@pytest.mark.parametrize(("make", "_fault"), run_protocols())
def test_a_drive_that_restarts_in_motion_is_lost_and_is_not_enabled_again(make, _fault):
    ends = Ends(make())
    ends.running()
    drives = ends.nodes._drives
    drives.seen.state[3], drives.seen.configured[3] = DriveState.BOOT, False
    end: Any = ends.nodes._end
    end.record["enabled"] = (1, 1, 1, 0, 1, 1)
    states = []
    for _ in range(10):
        ends.step(Command(DriveMode.RUN, np.zeros(6)))
        states.append(int(ends.measurement["drive_state"][3]))
    assert states == [DriveState.BOOT] * 10
    assert ends.nodes.snapshot().state[3] == DriveState.BOOT


@pytest.mark.parametrize(("make", "_fault"), run_protocols())
def test_another_controller_a_second_answer_and_a_stale_one_are_told_apart(make, _fault):
    ends = Ends(make())
    ends.until_set_up()
    ends.step()
    begun = ends.tick * PERIOD_NS
    answer = next(each for each in ends.received if ends.protocol.awaited(each.frame) == 2)
    bits = answer.frame.data[1] ^ 1
    other = answer._replace(
        frame=answer.frame._replace(data=bytes((answer.frame.data[0], bits)) + answer.frame.data[2:])
    )

    def measured(*frames: Received) -> Any:
        m = at_tick(ends.tick + 1)
        ends.protocol.decode(ends.dialogue, received_array(frames), ends.measurement, m, begun)
        return m

    m = measured(answer, other)
    assert (m["doubled"], m["foreign"], m["rejected"]) == (4, 0, 0)
    m = measured(answer, answer)
    assert m["doubled"] == 0, "the same again"
    third = next(each for each in ends.received if ends.protocol.awaited(each.frame) == 3)
    bits = third.frame.data[1] ^ 1
    fourth = third._replace(
        frame=third.frame._replace(data=bytes((third.frame.data[0], bits)) + third.frame.data[2:])
    )
    m = measured(answer, other, third, fourth)
    assert m["doubled"] == 4 + 8, "two drives at once"
    m = measured(answer, Received(begun, ends.opening[1]))
    assert (m["doubled"], m["foreign"]) == (0, Foreign.COMMAND)
    m = measured(answer._replace(t_ns=begun - 1))
    assert (m["rejected"], m["age"][2] > 0) == (1, True)


@pytest.mark.parametrize(("make", "_fault"), run_protocols())
def test_an_answer_that_comes_with_the_next_poll_measures_at_its_age_where_its_drive_owes_it(make, _fault):
    ends = Ends(make())
    ends.until_set_up()
    ends.step()
    begun = ends.tick * PERIOD_NS
    late = next(each for each in ends.received if ends.protocol.awaited(each.frame) == 2)
    late = late._replace(t_ns=begun - 1)
    missed = at_tick(ends.tick + 1)
    dialogue = ends.protocol.decode(ends.dialogue, NO_FRAMES, ends.measurement, missed, begun)
    missed["length"][2] = 7.0
    m = at_tick(ends.tick + 2)
    ends.protocol.decode(dialogue, received_array([late]), missed, m, begun)
    assert m["age"].tolist() == [2, 2, 1, 2, 2, 2]
    assert m["length"][2] == pytest.approx(float(ends.measurement["length"][2]))
    assert m["rejected"] == 1, "a drive that is always late is not relied upon"


@given(st.integers(0, 2**32 - 1))
def test_no_field_of_a_reply_or_command_is_off_by_more_than_the_resolution_and_some_by_most_of_it(seed):
    chance = np.random.default_rng(seed)
    stated = MitProtocol("cubemars", WIDE, NODES, 0, GEAR).protocol.traits.resolution.at(250.0)
    off = []
    for _ in range(30):
        p, v, t = chance.uniform(-0.99, 0.99, 3) * (WIDE.position, WIDE.velocity, WIDE.torque)
        p1, v1, _ = read_reply(bytes(device_motion(p, v, t, WIDE, clamps=True)), WIDE)
        t1 = unpack_command(pack_command(0.0, 0.0, 0.0, 0.0, t, WIDE), WIDE)[4]
        off.append(((p - p1) * LEAD_m / TURN, (v - v1) * LEAD_m / TURN, (t - t1) * NEWTONS))
    largest = np.abs(off).max(axis=0)
    steps = np.array([each[0] for each in (stated.length, stated.rate, stated.force)])
    assert (largest <= steps * (1.0 + 1e-9)).all()
    assert (largest > 0.6 * steps).all()


@pytest.mark.parametrize("variant", ["mini_cheetah", "cubemars", "damiao"])
def test_a_drive_is_enabled_by_a_controller_that_has_set_nothing_up(variant):
    protocol = MitProtocol(variant, WIDE, NODES, 16 if variant == "damiao" else 0, GEAR)
    nodes = Ends(protocol).nodes
    torque = pack_command(0.0, 0.0, 0.0, 0.0, 10.0, WIDE)
    for k, data in enumerate((b"\xff" * 7 + b"\xfc", torque, torque)):
        nodes.step(k * PERIOD_NS, [Received(k * PERIOD_NS, Frame(2, data))])
    assert nodes.snapshot().state.tolist() == [0, DriveState.RUN, 0, 0, 0, 0]
    assert nodes.snapshot().command[1] == pytest.approx(-10.0 * NEWTONS, abs=STEP_N)
    assert nodes.snapshot().rejected == 0


def test_a_drive_whose_ranges_are_others_is_not_set_up_and_says_which():
    ends = Ends(MitProtocol("damiao", WIDE, NODES, 16, GEAR))
    other = ByValue(MitProtocol("damiao", WIDE._replace(position=100.0), NODES, 16, GEAR))
    ends.dialogue = other.start(SETUP)
    ends.protocol = other
    for _ in range(100):
        ends.step()
    assert not any(other.legs_set_up(ends.dialogue))
    assert other.set_up_lacks(ends.dialogue)[0] == "PMAX (register 21) is 95.5 in the drive, 100 here"


def test_a_range_that_no_number_of_single_precision_holds_is_confirmed_by_what_comes_nearest():
    ends = Ends(
        MitProtocol("damiao", WIDE._replace(position=95.3, velocity=400.1, torque=143.9), NODES, 16, GEAR)
    )
    for _ in range(100):
        ends.step()
    assert all(ends.protocol.legs_set_up(ends.dialogue))


def test_a_position_at_the_end_of_its_range_is_no_reading():
    protocol = damiao()
    ends = Ends(protocol)
    ends.until_set_up(range(0))
    length = protocol.transmission.length(np.full(6, 12.6 / (2 * np.pi)))
    frames = answers(
        protocol, Sync(0), length, np.zeros(6), np.zeros(6), np.full(6, DriveState.OFF, np.int64)
    )
    m = at_tick(1)
    ends.protocol.decode(
        ends.dialogue, received_array([Received(0, frame) for _, frame in frames]), ends.measurement, m
    )
    assert m["blind"].tolist() == [1] * 6
    assert (m["age"] > 0).all()


def settings(**changes: Any) -> tuple[BusSettings, DriveSettings]:
    values = {
        "protocol": "mit",
        "transmission": {"lead_m": 0.02, "offset_m": 0.3},
        "options": {"variant": "damiao", "model": "DM4310"},
        "force_limit_N": 500.0,
    }
    layout = changes.pop("layout", "classic")
    return BusSettings(layout=layout), DriveSettings.model_validate(values | changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"transmission": None}, "drives.transmission: protocol mit speaks of motors"),
        ({"layout": "fd"}, "bus.layout: allowed with mit: classic, given: fd"),
        ({"options": {}}, "drives.options: variant of protocol mit: allowed: one of mini_cheetah, cubemars"),
        ({"options": {"variant": "damiao"}}, "model of protocol mit: allowed: one of DM4310"),
        ({"options": {"variant": "mini_cheetah", "gain": 1}}, "given: gain"),
        (
            {"options": {"variant": "mini_cheetah", "torque_N_m": -1}},
            "torque_N_m of protocol mit: allowed: a number",
        ),
        ({"options": {"variant": "mini_cheetah", "host_id": 3}}, "drives.options: host_id 3 makes replies"),
        (
            {"options": {"variant": "robstride", "model": "rs-02", "host_id": 5}},
            "drives.options: host_id of protocol mit: allowed: a whole number of 128 to 255, given: 5",
        ),
        (
            {"node_ids": [1, 2, 3, 4, 5, 16]},
            "drives.node_ids[5]: out of range, allowed with variant damiao: 1 to 15",
        ),
        # 4000 N x 20 mm / 2 pi = 12.73 N m
        (
            {"force_limit_N": 4000.0},
            "drives.force_limit_N: 4000 N need 12.73 N m of the motor (314.2 N a N m",
        ),
    ],
)
def test_settings_that_the_variant_does_not_have_are_refused_by_name(changes, message):
    with pytest.raises(ConfigurationError) as caught:
        loaded("hil.protocols", "mit")(*settings(**changes))
    assert message in str(caught.value)


@pytest.mark.parametrize("variant", list(VARIANTS))
def test_each_variant_can_be_configured(variant):
    model = next(iter(VARIANTS[variant].models))
    protocol = loaded("hil.protocols", "mit")(*settings(options={"variant": variant, "model": model}))
    assert len(protocol.traits.cyclic_frames) == 12


class Pushed(Given):
    """A plant that keeps what pushes its legs."""

    force = np.zeros(6)

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        self.force = force.copy()
        return super().step(force, brake, wrench, dt_s)


def test_what_friction_takes_the_command_has_added_and_the_drive_reports_the_force_of_the_leg():
    lossy = TransmissionSettings(
        lead_m=LEAD_m, sign=[1, -1, 1, -1, 1, -1], offset_m=1.75, efficiency=0.9, back_driving_efficiency=0.6
    )
    protocol = MitProtocol("damiao", WIDE, NODES, 16, Transmission(lossy))
    ends, plant = Ends(protocol), Pushed()
    drives = DriveSettings(heartbeat_ms=24.0, transmission=lossy, force_limit_N=3000.0)
    ends.nodes = Nodes(plant, protocol.protocol, DriveEmulation(encoder_resolution_m=0.0), drives)
    force = np.array(
        [1000.0, 2000.0, 3000.0, -3000.0, 0.0, -500.0]
    )  # both ways against RATE, and the rated one
    ends.running(force)
    ends.step(Command(DriveMode.RUN, force), set_up=False)
    np.testing.assert_allclose(plant.force, force, rtol=0, atol=STEP_N)
    np.testing.assert_allclose(ends.measurement["drive_force"], force, rtol=0, atol=2 * STEP_N)
    torque = ends.nodes._drives.seen.command[0] / NEWTONS
    assert torque == pytest.approx(1000.0 / 0.9 / NEWTONS, rel=0.01)
