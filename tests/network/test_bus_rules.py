"""Rules of the standard for a CAN bus, byte by byte: the operations are written by hand from FMI-LS-BUS 1.0."""

import threading

import pytest

from drivers.can.bus_time import BitTiming
from drivers.can.localcan.participant import Participant
from drivers.errors import PlantError
from drivers.frame_array import sent_array
from drivers.protocol import Frame
from plant_fmu.network.attached import Attached
from plant_fmu.network.operations import Operation, decode
from plant_fmu.network.shared_bus import SharedBus
from plant_fmu.network.station import Station, Stations
from tests.network.scripted_node import ScriptedNode

MS = 1_000_000
RATES = BitTiming(500_000, 2_000_000)
CLASSIC_1_NS = 2_000 * 65
"""One byte, identifier of 11 bits: 44 + 8 + 3 + floor((34 + 8 - 1) / 4) = 65 bits at 500 kbit/s."""
WAKEUP = "4200000008000000"
ACTIVE, PASSIVE, BUS_OFF = (f"4100000009000000{n:02x}" for n in (1, 2, 3))
BUFFER, DISCARD = (f"400000000a00000004{n:02x}" for n in (1, 2))


def transmit(identifier, data="aa"):
    size = len(data) // 2
    return f"10000000{16 + size:02x}000000{identifier:02x}0000000000{size:02x}00{data}"


def confirm(identifier):
    return f"200000000c000000{identifier:02x}000000"


def arbitration_lost(identifier):
    return f"300000000c000000{identifier:02x}000000"


def bus_error(identifier, flag, sender):
    return f"310000000f000000{identifier:02x}00000004{flag:02x}{sender:02x}"  # 4: CRC error


def run(*scripts, until_ns=10 * MS, **settings):
    """What each node received."""
    nodes = [ScriptedNode(script) for script in scripts]
    SharedBus(nodes, RATES, MS, **settings).run(until_ns)
    return [node.heard for node in nodes]


def test_wakeup_reaches_all_other_nodes_at_once_and_not_its_sender():
    first, second, third = run([(MS, WAKEUP)], [], [])
    assert first == []
    assert second == third == [(MS, WAKEUP)]


def test_frame_reaches_the_others_and_confirm_the_sender_at_its_end():
    first, second, third = run([(MS, transmit(0x10))], [], [])
    assert first == [(MS + CLASSIC_1_NS, confirm(0x10))]
    assert second == third == [(MS + CLASSIC_1_NS, transmit(0x10))]


def test_can_fd_frame_passes_unchanged_and_takes_the_time_of_its_bits():
    # 12 bytes with bit rate switch: 34 bits at 500 kbit/s, 153 bits at 2 Mbit/s.
    frame = "110000001d0000002101000000 01 01 0c00 0102030405060708090a0b0c".replace(" ", "")
    _, second = run([(MS, frame)], [])
    assert second == [(MS + 34 * 2_000 + 153 * 500, frame)]


def test_buffered_frame_that_loses_arbitration_follows_without_a_notification():
    loser, winner, listener = run([(MS, BUFFER + transmit(0x20))], [(MS, transmit(0x10))], [])
    end_ns = MS + CLASSIC_1_NS
    assert loser == [(end_ns, transmit(0x10)), (end_ns + CLASSIC_1_NS, confirm(0x20))]
    assert winner == [(end_ns, confirm(0x10)), (end_ns + CLASSIC_1_NS, transmit(0x20))]
    assert listener == [(end_ns, transmit(0x10)), (end_ns + CLASSIC_1_NS, transmit(0x20))]


def test_discarded_frame_that_loses_arbitration_is_notified_and_never_sent():
    loser, winner, listener = run([(MS, DISCARD + transmit(0x20))], [(MS, transmit(0x10))], [])
    end_ns = MS + CLASSIC_1_NS
    assert loser == [(end_ns, transmit(0x10) + arbitration_lost(0x20))]
    assert winner == [(end_ns, confirm(0x10))]
    assert listener == [(end_ns, transmit(0x10))]


@pytest.mark.parametrize("at_ns", [0, MS, MS + 1000])
def test_error_passive_node_loses_to_an_active_one_with_a_larger_identifier(at_ns):
    # The bus is busy from 1 ms on; the status counts when it falls free, not when the frame is queued.
    passive = sorted([(MS, transmit(0x10)), (at_ns, PASSIVE)], key=lambda each: each[0])
    _, _, listener = run(passive, [(MS, transmit(0x20))], [(MS - 1000, transmit(0x01))])
    assert [text for _, text in listener if text != confirm(0x01)] == [transmit(0x20), transmit(0x10)]


def test_frames_of_a_node_that_goes_bus_off_are_dropped_and_it_receives_none():
    off = [(MS, transmit(0x20)), (MS + 1000, BUS_OFF), (2 * MS, transmit(0x21)), (5 * MS, ACTIVE)]
    first, _, listener = run(off, [(MS - 1000, transmit(0x01)), (6 * MS, transmit(0x02))], [])
    assert [text for _, text in listener] == [transmit(0x01), transmit(0x02)]
    assert [text for _, text in first] == [transmit(0x02)]


def test_no_confirm_if_all_other_nodes_are_bus_off():
    first, _, _ = run([(MS, transmit(0x10))], [(0, BUS_OFF)], [(0, BUS_OFF)])
    assert first == []


def test_bus_error_names_one_primary_detector_and_the_sender():
    first, second, third = run([(MS, transmit(0x10))], [], [], error_every=1)
    assert [text for _, text in first] == [bus_error(0x10, 2, 1)]
    assert [text for _, text in second] == [bus_error(0x10, 1, 0)]
    assert [text for _, text in third] == [bus_error(0x10, 2, 0)]


def test_can_xl_frame_is_answered_with_a_format_error_of_all_its_bytes():
    frame = "120000001700000010000000000003000000000001 00ff".replace(" ", "")
    first, second = run([(MS, frame + transmit(0x10))], [])
    assert first[0] == (MS, f"0100000021000000 1700{frame}".replace(" ", ""))
    assert [text for _, text in second] == [transmit(0x10)]


def test_only_frames_that_ended_are_counted():
    bus = SharedBus([ScriptedNode([(MS, transmit(0x10)), (MS, transmit(0x11))]), ScriptedNode()], RATES, MS)
    bus.run(MS + CLASSIC_1_NS + 1)
    assert bus.frames == 1


def test_countdown_unknown_until_a_step_is_met_within_one_step(hosted):
    seen = []
    nodes = [hosted(0x100, SILENT_UNTIL_NS=3_300_000), hosted(0x200, OFFSET_NS=99 * MS)]
    SharedBus(nodes, RATES, MS, on_frame=lambda t_ns, *_: seen.append(t_ns)).run(5 * MS)
    assert 3_300_000 < seen[0] <= 4 * MS + 2_000 * 135


@pytest.mark.parametrize("last", ["NAN", "-1.0", "INFINITY", "5.0"])
def test_early_return_outside_of_its_step_is_refused(hosted, last):
    node = hosted(0x100, EARLY_S=last)
    node.exchange(b"")
    with pytest.raises(PlantError, match="returned early"):
        node.advance(MS)


@pytest.mark.parametrize("macros", [{"LIE": "1LL << 50"}, {"LIE": 2049}, {"NO_DATA": 1}])
def test_binary_beyond_its_declared_size_or_without_data_is_refused(hosted, macros):
    with pytest.raises(PlantError, match="Tx_Data"):
        SharedBus([hosted(0x100, **macros)], RATES, MS).run(2 * MS)


@pytest.mark.parametrize("wait", ["NAN", "-1.0", "INFINITY"])
def test_countdown_that_is_no_time_is_refused(hosted, wait):
    with pytest.raises(PlantError, match="Tx_Clock"):
        hosted(0x100, STUCK=wait).exchange(b"")


def test_fmu_that_is_due_without_end_is_refused_on_localcan_and_in_lockstep(hosted, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    node = hosted(0x100, STUCK="0.0")
    with pytest.raises(PlantError, match="without end"):
        SharedBus([node], RATES, MS).run(MS)
    link = Participant("stuck", RATES)
    with pytest.raises(PlantError, match="without end"):
        Attached(Stations([Station(node)]), [link], MS).run(MS)
    link.close()


def test_countdown_of_a_fixed_step_node_is_due_at_the_end_of_its_step(hosted):
    node = hosted(0x100, OFFSET_NS=3 * MS, FIXED_STEP_MS=10)
    node.exchange(b"")
    assert node.exchange(b"")  # its configuration
    assert node.next_ns() == 10 * MS


def test_frame_taken_back_on_localcan_is_the_one_that_is_notified(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    slow = BitTiming(2_000, 2_000)  # a frame of one byte takes 32.5 ms
    own, other = (Participant("order", slow, fd=False, own=mine) for mine in (True, False))
    node = ScriptedNode([(0, DISCARD)])
    attached = Attached(Stations([Station(node)]), [own], MS)
    other.send(sent_array([Frame(0x10, b"\1")]))
    both = decode(bytes.fromhex(transmit(0x30) + transmit(0x20)))
    attached.send((0, each) for each in both if isinstance(each, Operation))
    attached.run(150 * MS)
    for link in (own, other):
        link.close()
    texts = "".join(text for _, text in node.heard)
    assert arbitration_lost(0x30) in texts
    assert confirm(0x20) in texts
    assert arbitration_lost(0x20) not in texts
    assert len(decode(bytes.fromhex(texts))) == 3


def test_frames_between_two_steps_on_localcan_are_heard_when_they_end(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    first, second, other = (Participant("prompt", RATES, own=mine) for mine in (True, True, False))
    nodes = [ScriptedNode([(100 * MS, transmit(0x10))]), ScriptedNode()]
    later = threading.Timer(0.2, other.send, [sent_array([Frame(0x20, b"\xaa")])])
    later.start()
    Attached(Stations(map(Station, nodes)), [first, second], 1000 * MS).run(1000 * MS)
    for link in (first, second, other):
        link.close()
    own, frame = nodes[0].heard, nodes[1].heard
    assert [text for _, text in own] == [confirm(0x10), transmit(0x20)]
    assert [text for _, text in frame] == [transmit(0x10), transmit(0x20)]
    assert own[0][0] >= 100 * MS + CLASSIC_1_NS
    assert max(t_ns for t_ns, _ in own + frame) < 950 * MS
