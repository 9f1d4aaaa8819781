"""localcan: bit time, arbitration, queues, slow readers."""

from __future__ import annotations

import os
import random
import sys
import threading
import time

import pytest

from drivers.can.arbitration import priority
from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.can.link import OWN, collect
from drivers.can.localcan.layout import OFFSET_AT, SLOT_DUE, slot_at
from drivers.can.localcan.participant import DEFAULT_TIMING, Participant
from drivers.errors import BusError
from drivers.frame_array import sent_array
from drivers.protocol import EXTENDED, FD, REMOTE, Frame, Received
from tests.drivers.arbitration_queue import arbitrate
from tests.drivers.received_frames import CLASSIC_8_BYTES, CRAWL, got, soon

pytestmark = pytest.mark.usefixtures("runtime")


def test_frame_occupies_the_virtual_bus_for_its_bit_time_and_its_sender_gets_the_end_time(join):
    sender, reader = join(CRAWL), join(CRAWL)
    assert (sender.sent_ns(), sender.knows_ends) == ([], True)
    before = time.monotonic_ns()
    assert sender.send(sent_array([Frame(0x123, b"12345678")])) == 1
    (taken,) = sender.sent_ns()
    assert before <= taken <= time.monotonic_ns()
    assert got(reader.receive()) == []
    (received,) = got(collect(reader, soon()))
    got(sender.receive())
    assert received.frame == Frame(0x123, b"12345678", 0)
    assert before + CLASSIC_8_BYTES * 500_000 <= received.t_ns <= time.monotonic_ns()
    assert sender.sent_ns() == [received.t_ns]


def test_lowest_identifier_wins_arbitration_when_the_virtual_bus_becomes_free(join):
    a, b, c = join(CRAWL), join(CRAWL), join(CRAWL)
    # the first frame holds the bus, and the others meet at its end
    a.send(sent_array([Frame(0x700, bytes(8))]))
    a.send(sent_array([Frame(0x300, b"a")]))
    b.send(sent_array([Frame(0x200, b"b"), Frame(0x100 << 18, b"x", EXTENDED)]))
    a.send(sent_array([Frame(0x100, b"", REMOTE)]))
    b.send(sent_array([Frame(0x100, b"")]))
    received = got(collect(c, soon(), {0x700, 0x200, 0x300}))
    heard = [(r.frame.id, r.frame.flags) for r in received]
    assert heard[:3] == [(0x700, 0), (0x100, 0), (0x100, REMOTE)]
    assert heard[3:] == [(0x100 << 18, EXTENDED), (0x200, 0), (0x300, 0)]


def test_every_participant_receives_frames_in_the_same_order_with_the_same_times(join):
    a, b, c = join(), join(own=True), join()
    for i in range(10):
        a.send(sent_array([Frame(0x200 - i, b"a")]))
        b.send(sent_array([Frame(0x100 + i, b"b")]))
    last = soon(0.3)
    seen_by_b, seen_by_c = got(collect(b, last, {0x7FF})), got(collect(c, last, {0x7FF}))
    assert len(seen_by_c) == 20
    assert [(r.t_ns, r.frame.id) for r in seen_by_b] == [(r.t_ns, r.frame.id) for r in seen_by_c]
    assert sum(bool(r.frame.flags & OWN) for r in seen_by_b) == 10


def test_node_has_a_limited_send_queue_and_flushes_only_its_own_frames(join):
    a, b, c = join(CRAWL), join(CRAWL), join(CRAWL)
    assert a.send(sent_array([Frame(0x01 + k, bytes(8)) for k in range(70)])) == 64
    b.send(sent_array([Frame(0x50, b""), Frame(0x51, b"")]))
    assert 62 <= a.flush_tx() <= 64, "one of them may have started, and stays on the wire"
    assert a.send(sent_array([Frame(0x77, b"")])) == 1
    heard = [r.frame.id for r in got(collect(c, soon(), {0x77}))]
    assert [each for each in heard if each >= 0x50] == [0x50, 0x51, 0x77]
    assert len(heard) <= 5


@pytest.mark.parametrize(("length", "carried"), [(8, 8), (9, 12), (33, 48), (64, 64)])
def test_can_fd_frame_is_padded_to_a_valid_length(join, length, carried):
    a, b = join(), join()
    data = bytes(range(1, length + 1))
    for _ in range(2):
        assert a.send(sent_array([Frame(0x10, data, FD)])) == 1
        (received,) = got(collect(b, soon()))
        assert received.frame.data == data + bytes(carried - length)


@pytest.mark.parametrize(
    "frame",
    [Frame(0x800, b""), Frame(0x20000000, b"", EXTENDED), Frame(1, bytes(9)), Frame(1, bytes(8), FD)],
    ids=str,
)
def test_frame_that_the_virtual_bus_cannot_carry_is_refused(join, frame):
    node = join(BitTiming(500_000, 500_000), fd=False)
    with pytest.raises(BusError):
        node.send(sent_array([frame]))
    assert node.flush_tx() == 0
    assert node.send(sent_array([Frame(0x7FF, b""), Frame(0x1FFFFFFF, b"", EXTENDED)])) == 2


@pytest.mark.parametrize(("senders", "each"), [(1, 3 * 8192), (2, 40_000)])
def test_slow_reader_loses_the_oldest_frames_and_counts_the_losses(join, senders, each):
    """An outbox holds 8192 frames, the common log 32768."""
    fast = BitTiming(1_000_000_000, 1_000_000_000)
    nodes, reader = [join(fast) for _ in range(senders)], join(fast)
    for k in range(0, each, 32):
        for node in nodes:
            frames = [Frame((k + i) & 0x7FF, b"") for i in range(32)]
            while frames:
                frames = frames[node.send(sent_array(frames)) :]
    time.sleep(0.01)
    received, lost = got(reader.receive()), reader.overflow
    assert 0 < len(received) <= senders * 8192
    assert len(received) + lost == pytest.approx(senders * each, rel=0 if senders == 1 else 0.01)
    if senders == 1:
        assert [r.frame.id for r in received[-64:]] == [(each - 64 + i) & 0x7FF for i in range(64)]
    assert (got(reader.receive()), reader.overflow) == ([], lost)
    nodes[0].send(sent_array([Frame(0x123, b"now")]))
    assert got(collect(reader, soon(), {0x123}))[-1].frame.data == b"now"


def test_first_participant_fixes_the_bit_rates_and_others_with_different_rates_are_refused(join):
    viewer = join(None, None)
    join(DEFAULT_TIMING)
    assert viewer.mode.timing == DEFAULT_TIMING
    with pytest.raises(BusError, match=r"1000000/5000000.*500000/2000000"):
        join(BitTiming(500_000, 2_000_000))
    with pytest.raises(BusError, match=f"classic CAN 1000000.*{os.getpid()}"):
        join(DEFAULT_TIMING, fd=False)


def test_several_threads_may_send_and_receive_through_one_participant(join):
    a, b = join(), join()
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    received: list[Received] = []
    try:
        senders = [threading.Thread(target=_send_all, args=(a, first)) for first in (0, 1000)]
        for thread in senders:
            thread.start()
        while any(thread.is_alive() for thread in senders):
            received += got(b.receive())
            got(a.receive())
        for thread in senders:
            thread.join()
    finally:
        sys.setswitchinterval(before)
    received += got(collect(b, soon(0.3), {0x7FF}))
    assert sorted(int.from_bytes(r.frame.data, "little") for r in received) == list(range(2000))


def _send_all(node, first):
    for k in range(first, first + 1000):
        while not node.send(sent_array([Frame(0x100, k.to_bytes(2, "little"), FD)])):
            time.sleep(1e-4)


@pytest.mark.parametrize("seed", range(20))
def test_order_of_frames_on_the_virtual_bus_equals_that_of_computed_arbitration(runtime, monkeypatch, seed):
    """Random traffic on a wire with a manual clock, against `arbitrate`."""
    chance = random.Random(seed)
    now = [1_000_000]
    nodes = [Participant("t", DEFAULT_TIMING) for _ in range(3)]
    for node in nodes:
        node.clock.begin(1, 1)

    def set_time(t_ns):
        # bench time stands still at the earliest due
        words = nodes[0]._wire.words
        words[slot_at(nodes[0].serial) + SLOT_DUE] = t_ns
        now[0] = t_ns

    start_ns = nodes[0].clock.now() + 1_000_000_000
    for node in nodes:
        node.clock.holds = True
        monkeypatch.setattr(node.clock, "sends", lambda: None)
    nodes[0]._wire.words[OFFSET_AT] = -10_000_000_000
    set_time(start_ns)
    queued: list[tuple[int, int, int, int]] = []
    names: list[tuple[int, int]] = []
    heard: list[list[Received]] = [[] for _ in nodes]
    for _ in range(300):
        set_time(now[0] + chance.randrange(200_000))
        who = chance.randrange(3)
        if chance.random() < 0.7:
            size, id_ = chance.randrange(9), chance.randrange(0x700)
            assert nodes[who].send(sent_array([Frame(id_, bytes(size))])) == 1
            queued.append((now[0], priority(id_, 0), len(names), frame_time_ns(size, 0, DEFAULT_TIMING)))
            names.append((who, id_))
        reader = chance.randrange(3)
        heard[reader] += got(nodes[reader].receive())
    set_time(now[0] + 10**9)
    sent, _ = arbitrate(queued, 0, 1 << 62)
    for me, node in enumerate(nodes):
        heard[me] += got(node.receive())
        expected = [(end, names[i][1]) for i, end in sent if names[i][0] != me]
        assert [(r.t_ns, r.frame.id) for r in heard[me]] == expected
    for node in nodes:
        node.close()
