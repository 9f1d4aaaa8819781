"""CiA 402 frames, byte for byte as the package canopen 2.4.1 makes and reads them (tests/data)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.cia402 import objects as o
from drivers.cia402.end import plan
from drivers.cia402.states import STATE_OF, State, controlword
from drivers.errors import ProtocolError
from drivers.frame_array import received_array
from drivers.protocol import DriveSetup, Frame, Received
from drivers.signals import LEGS, NEVER, Command, DriveFault, DriveMode, DriveState, Foreign, Reaction
from drivers.tick_columns import new_record
from hil.contracts.by_value import ByValue
from hil.contracts.messages import Status, Sync
from tests.drivers.cia402_drives import COUNTS, PERMILLE_N, SCREW_m, STEP_m, changed, drives, holding

DATA = json.loads((Path(__file__).parents[1] / "data/cia402_vectors.json").read_text(encoding="utf-8"))
VECTORS = DATA["vectors"]
SETUP = DriveSetup(0.05, Reaction.DAMP, 250.0)
NODES = (1, 2, 3, 4, 5, 6)
LEG = 4
"""Of node 5."""
P = ByValue(drives(NODES))
RUNNING = holding(P.protocol, [DriveState.RUN] * 6)
"""What drives remember that have been set up."""


def vectors(what: str):
    found = [v for v in VECTORS if v["what"].startswith(what)]
    assert found, what
    return found


def frame(vector) -> Frame:
    return Frame(vector["id"], bytes.fromhex(vector["data"]))


def decoded(frames, protocol=P, *, since_ns=0, t_ns=1):
    m = new_record()
    m["tick"] = 0
    dialogue = protocol.decode(
        protocol.start(SETUP), received_array([Received(t_ns, f) for f in frames]), new_record(), m, since_ns
    )
    return dialogue, m


def test_the_set_up_maps_the_pdos_in_the_order_and_with_the_bytes_of_canopen():
    steps = [step for step in plan(5, SETUP, P) if step.kind == "write"]
    sent = [Frame(0x605, step.request(5)) for step in steps]
    for pdo in ("remap RPDO1", "remap TPDO1"):
        expected = [frame(v) for v in vectors(pdo)]
        at = sent.index(expected[0])
        assert sent[at : at + len(expected)] == expected


def test_nmt_commands_have_the_bytes_of_canopen():
    steps = [Frame(0x000, step.request(5)) for step in plan(5, SETUP, P) if step.kind == "nmt"]
    expected = [
        frame(v)
        for v in VECTORS
        if v["what"] in ("NMT to node 5: PRE-OPERATIONAL", "NMT to node 5: OPERATIONAL")
    ]
    assert sorted(steps) == sorted(expected)


def test_sync_and_the_heartbeat_have_the_bytes_of_canopen():
    assert P.begin(P.start(SETUP), 7) == (frame(vectors("SYNC without counter")[0]),)
    _, sent = P.command(P.start(SETUP), Command(DriveMode.OFF, np.zeros(LEGS)), 0)
    assert sent[-1] == Frame(0x700 + 127, frame(vectors("heartbeat OPERATIONAL")[0]).data)


@pytest.mark.parametrize("vector", vectors("SDO request: download"), ids=lambda v: v["what"])
def test_a_download_has_the_bytes_of_canopen(vector):
    said = vector["inputs"]
    size = {"u16": 2, "i16": 2, "i8": 1, "i32": 4}[said["type"]]
    assert o.download((int(said["index"], 16), said["sub"]), said["value"], size) == frame(vector).data


@pytest.mark.parametrize("vector", vectors("SDO request: upload"), ids=lambda v: v["what"])
def test_an_upload_has_the_bytes_of_canopen(vector):
    said = vector["inputs"]
    assert o.upload((int(said["index"], 16), said["sub"])) == frame(vector).data


@pytest.mark.parametrize("vector", vectors("SDO reply: upload"), ids=lambda v: v["what"])
def test_an_answer_is_read_as_canopen_reads_it(vector):
    said = vector["inputs"]
    bits = {0x4B: 16, 0x43: 32}[frame(vector).data[0]]
    value = vector["decoded"]["value"] % (1 << bits)
    assert o.read_value(frame(vector).data) == ((int(said["index"], 16), said["sub"]), value)


@pytest.mark.parametrize("vector", vectors("SDO abort"), ids=lambda v: v["what"])
def test_an_abort_is_read_with_its_meaning_and_written_as_canopen_does(vector):
    said, data = vector["inputs"], frame(vector).data
    code = int.from_bytes(data[4:], "little")
    assert o.abort((int(said["index"], 16), said["sub"]), code) == data
    meanings = {"0x2000": "does not exist in", "0x1600": "sub-index does not", "0x6041": "write a read only"}
    assert meanings[said["index"]] in o.ABORTS[code]


@pytest.mark.parametrize(
    "vector", vectors("statusword decoded"), ids=lambda v: hex(v["inputs"]["statusword"])
)
def test_a_statusword_is_the_state_that_canopen_reads(vector):
    names = {
        "READY TO SWITCH ON": State.READY_TO_SWITCH_ON,
        "SWITCHED ON": State.SWITCHED_ON,
        "OPERATION ENABLED": State.ENABLED,
        "QUICK STOP ACTIVE": State.QUICK_STOP,
        "FAULT REACTION ACTIVE": State.FAULT_REACTION,
        "FAULT": State.FAULT,
        "UNKNOWN": -1,
    }
    assert STATE_OF[vector["inputs"]["statusword"] & 0x7F] == names[vector["decoded"]["state"]]


@pytest.mark.parametrize(
    ("state", "mode", "word"),
    [
        ("SWITCH ON DISABLED", DriveMode.READY, "shutdown"),
        ("READY TO SWITCH ON", DriveMode.READY, "switch_on"),
        ("OPERATION ENABLED", DriveMode.READY, "switch_on"),
        ("SWITCHED ON", DriveMode.RUN, "enable_operation"),
        ("OPERATION ENABLED", DriveMode.RUN, "enable_operation"),
        ("SWITCH ON DISABLED", DriveMode.RUN, "disable_voltage"),
        ("OPERATION ENABLED", DriveMode.OFF, "shutdown"),
        ("SWITCHED ON", DriveMode.OFF, "shutdown"),
        ("QUICK STOP ACTIVE", DriveMode.OFF, "shutdown"),
        ("SWITCH ON DISABLED", DriveMode.OFF, "disable_voltage"),
        ("READY TO SWITCH ON", DriveMode.RUN, "disable_voltage"),
        ("FAULT", DriveMode.RUN, "disable_voltage"),
        ("QUICK STOP ACTIVE", DriveMode.RUN, "disable_voltage"),
        ("FAULT", DriveMode.RESET, "fault_reset"),
    ],
)
def test_a_controlword_is_that_of_canopens_table(state, mode, word):
    masks = DATA["tables"]["statusword_masks"][state]
    known = STATE_OF[int(masks["value"], 16)]
    assert controlword(mode, known, edge=True, stopped=False) == DATA["tables"]["controlwords"][word]


@pytest.mark.parametrize("vector", vectors("TPDO1 statusword"), ids=lambda v: v["data"])
def test_a_tpdo_of_node_5_is_length_force_and_state(vector):
    said = vector["inputs"]
    protocol = ByValue(drives(NODES, velocity=False))
    _, m = decoded([frame(vector)], protocol)
    assert m["age"].tolist() == [NEVER] * 4 + [0, NEVER]
    assert m["length"][LEG] == pytest.approx(0.75 + SCREW_m * said["position_counts"] / COUNTS, abs=1e-9)
    assert m["drive_force"][LEG] == pytest.approx(PERMILLE_N * said["torque_permille"])
    states = {561: DriveState.OFF, 567: DriveState.RUN, 536: DriveState.FAULT}
    assert m["drive_state"][LEG] == states[said["statusword"]]


def test_emcy_and_boot_up_have_the_bytes_of_canopen():
    _, booted = P.report(P.power_up(), Status(LEG, DriveState.BOOT, 0))
    assert booted == (frame(vectors("heartbeat INITIALISING")[0]),)
    memory = changed(RUNNING, LEG, {o.PRODUCER_HEARTBEAT: 0})
    lost = Status(LEG, DriveState.FAULT, DriveFault.WATCHDOG)
    for status, what in ((lost, "EMCY 0x8130"), (Status(LEG, DriveState.OFF, 0), "EMCY error reset")):
        memory, sent = P.report(memory, status)
        assert sent == (frame(vectors(what)[0]),)


@pytest.mark.parametrize("vector", vectors("EMCY"), ids=lambda v: v["what"])
def test_an_emcy_is_the_drives_fault(vector):
    _, m = decoded([frame(vector)])
    assert m["drive_fault"].tolist() == [0] * 4 + [vector["inputs"]["error_code"], 0]


inside = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6)


@given(st.lists(st.integers(-(1 << 31), (1 << 31) - 1), min_size=6, max_size=6), inside, inside)
def test_length_rate_and_force_come_back_over_the_whole_range(counts, speed, torque):
    sign, offset = np.array([1, -1, 1, -1, 1, 1]), np.array([0.75] * 5 + [0.5])
    length = offset + sign * STEP_m * np.array(counts)
    rate = np.array(speed) * 300.0
    force = np.array(torque) * 32767 * PERMILLE_N
    frames = [f for _, f in P.answer(RUNNING, Sync(0), length, rate, force, np.full(6, DriveState.RUN))[1]]
    _, m = decoded(frames)
    np.testing.assert_allclose(m["length"], length, rtol=0, atol=STEP_m / 2 * 1.001 + 1e-9)
    np.testing.assert_allclose(m["rate"], rate, rtol=0, atol=STEP_m / 2 * 1.001)
    np.testing.assert_allclose(m["drive_force"], force, rtol=0, atol=PERMILLE_N / 2 * 1.001)


@pytest.mark.parametrize("side", [1, -1])
def test_a_reading_saturates_at_the_edge_of_its_field(side):
    far = np.full(6, side * 1e9)
    frames = [f for _, f in P.answer(RUNNING, Sync(0), far, far, far, np.full(6, DriveState.RUN))[1]]
    m = decoded(frames)[1]
    assert abs(m["length"][0] - 0.75) == pytest.approx((1 << 31) * STEP_m, abs=2 * STEP_m)
    assert abs(m["rate"][0]) == pytest.approx((1 << 31) * STEP_m, abs=2 * STEP_m)
    assert abs(m["drive_force"][0]) == pytest.approx(32768 * PERMILLE_N, rel=1e-4)
    assert m["length"][1] > 0 if side > 0 else m["length"][1] < 0


@given(st.lists(st.integers(-32767, 32767), min_size=6, max_size=6))
def test_a_force_is_thousandths_of_the_rated_torque_with_the_legs_sign(permille):
    sign = np.array([1, -1, 1, -1, 1, 1])
    command = Command(DriveMode.RUN, sign * PERMILLE_N * np.array(permille))
    _, frames = P.command(P.start(SETUP)._replace(states=(State.ENABLED,) * 6), command, 1)
    assert [f.data for f in frames] == [b"\x0f\0" + p.to_bytes(2, "little", signed=True) for p in permille]


def test_a_force_just_beyond_the_field_is_refused():
    fits = 32767.4 * PERMILLE_N
    for force, ok in ((fits, True), (fits + 0.2 * PERMILLE_N, False)):
        command = Command(DriveMode.RUN, np.array([0, force, 0, 0, 0, 0]))
        if ok:
            P.command(P.start(SETUP), command, 0)
        else:
            with pytest.raises(ProtocolError, match="0x6071"):
                P.command(P.start(SETUP), command, 0)


def test_wrong_lengths_and_statuswords_are_counted_and_frames_of_others_named():
    good = Frame(0x185, bytes.fromhex("3702000000000000"))
    speed = Frame(0x285, bytes(4))
    for bad in (
        good._replace(data=good.data[:7]),
        good._replace(data=b"\xff" + good.data[1:]),
        speed._replace(data=bytes(8)),
        Frame(0x085, bytes(7)),
        Frame(0x705, b"\x06"),
        Frame(0x705, b""),
        Frame(0x585, bytes(8)),
    ):
        _, m = decoded([bad])
        assert (m["rejected"], m["age"][LEG]) == (1, NEVER), bad
    _, m = decoded([good._replace(id=0x18A), Frame(0x48A, bytes(8)), good, speed])
    assert (m["rejected"], m["foreign"], m["age"][LEG]) == (0, 0, 0)
    for stranger, name in (
        (Frame(0x080, b""), Foreign.SYNC),
        (Frame(0x000, b"\x01\x05"), Foreign.CONFIG),
        (Frame(0x205, bytes(4)), Foreign.COMMAND),
        (Frame(0x605, bytes(8)), Foreign.CONFIG),
        (Frame(0x77F, b"\x05"), Foreign.COMMAND),
    ):
        assert decoded([stranger])[1]["foreign"] == name


FIRST, SECOND = (Frame(0x185, bytes.fromhex(f"3702{count}0000000000")) for count in ("64", "65"))
"""TPDO1 of node 5, enabled, 100 and 101 counts from zero."""
SPEEDS = [Frame(0x285, bytes(4)), Frame(0x285, b"\x01" + bytes(3))]
"""Its TPDO2, 0 and 1 count/s."""


def after(*ticks):
    """Return the measurement of the last of some ticks with these frames, after twenty calm ones."""
    dialogue, m = P.start(SETUP), new_record()
    for number, frames in enumerate([[FIRST, SPEEDS[0]]] * 20 + list(ticks)):
        last, m = m, new_record()
        m["tick"] = number
        dialogue = P.decode(dialogue, received_array([Received(1, frame) for frame in frames]), last, m, 0)
    return m


def test_an_answer_from_before_the_sync_is_a_tick_old():
    _, m = decoded([FIRST, SPEEDS[0]], since_ns=10, t_ns=9)
    assert m["age"][LEG] == 1
    assert not P.fresh(Received(9, FIRST), 0, 10)
    assert P.fresh(Received(10, FIRST), 0, 10)
    assert decoded([FIRST])[1]["age"][LEG] == NEVER, "a length without its rate is none"


@pytest.mark.parametrize("late", [0, 1])
def test_a_rate_of_differences_is_timed_by_the_sync_that_each_answer_is_to(late):
    """Ten counts in 0.1 ms from SYNC to SYNC of unlike distances, answers of this tick or of the one before."""
    protocol, last = ByValue(drives(NODES, velocity=False)), new_record()
    dialogue = protocol.start(SETUP)
    at = np.cumsum([0, 43, 37, 46, 34, 41, 38, 44, 36])
    counts = [int(10 * at[k]).to_bytes(4, "little") for k in range(len(at))]
    for k in range(late, len(at)):
        m = new_record()
        m["tick"], m["t_ns"] = k, 100_000 * at[k]
        heard = Received(m["t_ns"].item() + 1, Frame(0x185, b"\x37\x02" + counts[k - late] + bytes(2)))
        dialogue = protocol.decode(dialogue, received_array([heard]), last, m, int(m["t_ns"]) + 2 * late)
        last = m
    assert last["age"][LEG] == late
    assert last["rate"][LEG] == pytest.approx(10 * STEP_m / 1e-4, rel=1e-9)


def test_a_leg_is_as_old_as_the_older_one_of_its_two_tpdos():
    last, m = new_record(), new_record()
    last["tick"], last["age"], m["tick"] = 9, 3, 10
    run = received_array([Received(9, SPEEDS[0]), Received(11, FIRST)])
    P.decode(P.start(SETUP), run, last, m, 10)
    assert m["age"][LEG] == 4, "the velocity is that of an older SYNC"


def test_a_drive_that_boots_after_its_answer_is_in_boot():
    _, m = decoded([FIRST, SPEEDS[0], Frame(0x705, b"\0")])
    assert m["drive_state"][LEG] == DriveState.BOOT
    assert m["age"][LEG] == NEVER


def test_a_second_answer_to_one_sync_doubles_the_node():
    m = after([FIRST, SPEEDS[0], SECOND])
    assert (m["doubled"], m["length"][LEG]) == (1 << LEG, pytest.approx(0.75 + 100 * STEP_m))
    assert after([FIRST, *SPEEDS])["doubled"] == 1 << LEG
    assert after([FIRST, SPEEDS[0], FIRST])["doubled"] == 0


def test_a_drive_that_owes_the_answer_of_the_tick_before_may_send_two_and_the_second_counts():
    m = after([], [FIRST, SPEEDS[0], SECOND, SPEEDS[1]])
    assert (m["doubled"], m["age"][LEG]) == (0, 0)
    assert m["length"][LEG] == pytest.approx(0.75 + 101 * STEP_m, abs=STEP_m / 4)
    assert m["rate"][LEG] == pytest.approx(STEP_m)


def test_a_drive_that_answers_a_tick_late_may_catch_up_in_a_later_one():
    calm, both = [FIRST, SPEEDS[0]], [FIRST, SPEEDS[0], SECOND, SPEEDS[1]]
    assert after([], calm, calm, both)["doubled"] == 0
    assert after([], calm, both, both)["doubled"] == 1 << LEG, "it owed one alone"
    assert after([], *[calm] * 8, both)["doubled"] == 1 << LEG, "an answer that was lost does not come"


@pytest.mark.parametrize("leg", range(LEGS))
@pytest.mark.parametrize(
    ("data", "state", "held", "fault"),
    [
        pytest.param("4b3f600005730000", DriveState.FAULT, 0, 0x7305, id="error code"),
        pytest.param("433f600005730000", DriveState.FAULT, 0, 0x7305, id="in four bytes"),
        pytest.param("4b3f600005730000", DriveState.FAULT, 0x2310, 0x2310, id="an EMCY has said it"),
        pytest.param("4b3f600005730000", DriveState.OFF, 0, 0, id="no fault"),
        pytest.param("803f600000000206", DriveState.FAULT, 0, 0, id="no such object"),
        pytest.param("4b41600005730000", DriveState.FAULT, 0, 0, id="another object"),
        pytest.param("423f6000", DriveState.FAULT, 0, 0, id="too short"),
    ],
)
def test_the_error_code_that_is_read_is_the_fault_of_a_drive_whose_emcy_was_missed(
    leg, data, state, held, fault
):
    last, m = new_record(), new_record()
    last["drive_state"][leg], last["drive_fault"][leg], m["tick"] = state, held, 1
    answer = Frame(0x580 + NODES[leg], bytes.fromhex(data))
    P.decode(P.start(SETUP), received_array([Received(1, answer)]), last, m, 0)
    assert m["drive_fault"].tolist() == [fault if each == leg else 0 for each in range(LEGS)]
