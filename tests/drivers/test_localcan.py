"""localcan: bit time, arbitration, killed participants."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import json
import os
import random
import select
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time

import pytest

from drivers.can.arbitration import priority
from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.can.link import OWN, collect
from drivers.can.localcan import layout, participant
from drivers.can.localcan.layout import OFFSET_AT, SLOT_DUE, SLOT_RUNG, slot_at
from drivers.can.localcan.participant import Participant
from drivers.can.runtime_folder import runtime_folder
from drivers.errors import BusError
from drivers.frame_array import sent_array
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE, Frame, Received
from tests.drivers.arbitrated import arbitrate
from tests.drivers.frames_heard import got

pytestmark = pytest.mark.usefixtures("runtime")
FAST = BitTiming(1_000_000, 5_000_000)
SLOW = BitTiming(125_000, 125_000)
CRAWL = BitTiming(2_000, 2_000)
"""A frame of 8 bytes takes 67.5 ms: what has to happen meanwhile does so on a busy machine, too."""
SNAIL = BitTiming(200, 200)
"""Nothing ends while a test looks."""
CLASSIC_8_BYTES = 135
"""Worst-case bits, hence 135 us at 1 Mbit/s."""


def soon(seconds=2.0):
    return time.monotonic_ns() + int(seconds * 1e9)


def start(code, timing="1_000_000, 5_000_000", stdin=None):
    """Start a child that is on the bus when this returns."""
    command = [sys.executable, "-c", PREAMBLE.format(timing) + code]
    child = subprocess.Popen(command, stdin=stdin, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    return child


def end(child):
    child.kill()
    child.wait(10)
    for stream in (child.stdin, child.stdout):
        if stream is not None:
            stream.close()


PREAMBLE = """
import os, sys, time
from drivers.can.bus_time import BitTiming
from drivers.can.localcan.layout import OFFSET_AT, SLOT_DUE, SLOT_RUNG, slot_at
from drivers.can.localcan.participant import Participant
from drivers.frame_array import received_frames, sent_array
from drivers.protocol import Frame
node = Participant("t", BitTiming({}), fd=True)
give, take = node.send, node.receive
node.send = lambda frames: give(sent_array(frames))
node.receive = lambda: [*received_frames(take())]
print("ready", flush=True)
"""


def test_a_frame_takes_its_bit_time(join):
    a, b = join(CRAWL), join(CRAWL)
    before = time.monotonic_ns()
    assert a.send(sent_array([Frame(0x123, b"12345678")])) == 1
    assert got(b.receive()) == []
    (received,) = got(collect(b, soon()))
    after = time.monotonic_ns()
    assert received.frame == Frame(0x123, b"12345678", 0)
    assert before + CLASSIC_8_BYTES * 500_000 <= received.t_ns <= after


def test_a_frame_is_out_at_its_end_and_until_that_is_seen_when_it_was_taken(join):
    a, b = join(CRAWL), join(CRAWL)
    before = time.monotonic_ns()
    a.send(sent_array([Frame(0x123, b"12345678")]))
    after = time.monotonic_ns()
    (taken,) = a.sent_ns()
    assert before <= taken <= after
    (received,) = got(collect(b, soon()))
    got(a.receive())
    assert a.sent_ns() == [received.t_ns]
    assert a.knows_ends


@pytest.mark.realtime(patient=True)
def test_frames_follow_each_other_on_the_wire(join):
    a, b = join(), join()
    frames = [Frame(0x100 + i, bytes(8)) for i in range(20)]
    a.send(sent_array(frames))
    received = got(collect(b, soon(), frozenset(frame.id for frame in frames)))
    times = [r.t_ns for r in received]
    assert [r.frame for r in received] == frames
    assert {t - s for s, t in itertools.pairwise(times)} == {CLASSIC_8_BYTES * 1000}


def test_lowest_identifier_wins_when_the_bus_falls_free(join):
    a, b, c = join(CRAWL), join(CRAWL), join(CRAWL)
    # the first frame holds the bus, and the others meet at its end
    a.send(sent_array([Frame(0x700, bytes(8))]))
    a.send(sent_array([Frame(0x300, b"a")]))
    b.send(sent_array([Frame(0x200, b"b"), Frame(0x100 << 18, b"x", EXTENDED)]))
    a.send(sent_array([Frame(0x100, b"", REMOTE)]))
    b.send(sent_array([Frame(0x100, b"")]))
    received = got(collect(c, soon(), {0x700, 0x200, 0x300}))
    assert [(r.frame.id, r.frame.flags) for r in received] == [
        (0x700, 0),
        (0x100, 0),
        (0x100, REMOTE),
        (0x100 << 18, EXTENDED),
        (0x200, 0),
        (0x300, 0),
    ]


def test_every_participant_sees_the_same_order_and_times(join):
    a, b, c = join(), join(own=True), join()
    for i in range(10):
        a.send(sent_array([Frame(0x200 - i, b"a")]))
        b.send(sent_array([Frame(0x100 + i, b"b")]))
    last = soon(0.3)
    seen_by_b, seen_by_c = got(collect(b, last, {0x7FF})), got(collect(c, last, {0x7FF}))
    assert len(seen_by_c) == 20
    assert [(r.t_ns, r.frame.id) for r in seen_by_b] == [(r.t_ns, r.frame.id) for r in seen_by_c]
    assert sum(bool(r.frame.flags & OWN) for r in seen_by_b) == 10


def test_drain_returns_when_all_wanted_have_come_and_at_the_deadline_otherwise(join):
    a, b = join(CRAWL), join(CRAWL)
    a.send(sent_array([Frame(1, bytes(8)), Frame(2, bytes(8)), Frame(3, bytes(8))]))
    assert [r.frame.id for r in got(collect(b, soon(), {1, 2}))] == [1, 2]
    deadline = soon(0.1)
    assert [r.frame.id for r in got(collect(b, deadline, {3, 4}))] == [3]
    assert 0 <= time.monotonic_ns() - deadline < 60_000_000
    assert got(collect(b, soon(), frozenset())) == []


def test_send_queue_is_bounded_and_can_be_flushed(join):
    a, b = join(CRAWL, tx_limit=8), join(CRAWL)
    assert a.send(sent_array([Frame(i, bytes(8)) for i in range(12)])) == 8
    # one of them may have started
    assert 6 <= a.flush_tx() <= 8
    assert a.send(sent_array([Frame(0x77, b"")])) == 1
    assert got(collect(b, soon(), {0x77}))[-1].frame.id == 0x77


def test_a_flush_drops_the_frames_of_who_flushes_and_no_others(join):
    a, b, c = join(CRAWL), join(CRAWL), join(CRAWL)
    a.send(sent_array([Frame(0x10 + k, b"") for k in range(5)]))
    b.send(sent_array([Frame(0x50, b""), Frame(0x51, b"")]))
    assert 4 <= a.flush_tx() <= 5, "one of them may have started"
    heard = [r.frame.id for r in got(collect(c, soon(), {0x50, 0x51}))]
    assert [each for each in heard if each >= 0x50] == [0x50, 0x51]
    assert len(heard) <= 3


def test_a_node_takes_no_more_than_all_together_may_have_waiting(join, monkeypatch):
    monkeypatch.setattr(participant, "QUEUE_LIMIT", 5)
    a, b = join(SNAIL), join(SNAIL)
    frames = [Frame(0x10 + k, bytes(8)) for k in range(4)]
    assert a.send(sent_array(frames)) == 4
    assert b.send(sent_array(frames)) == 2, "three of the other's wait, and one has the bus"


def test_the_next_frame_of_another_is_foreseen_under_way_or_waiting_and_none_of_its_own(join, monkeypatch):
    a, b = join(SNAIL), join(SNAIL)
    assert a.send(sent_array([Frame(0x10, bytes(8))])) == 1
    assert (got(a.receive()), got(b.receive())) == ([], [])
    assert a.foresee() is None
    under_way = b.foresee()
    assert b.send(sent_array([Frame(0x20, bytes(8))])) == 1
    assert got(a.receive()) == []
    waiting = a.foresee()
    now = type(a.clock).now
    monkeypatch.setattr(type(a.clock), "now", lambda clock: now(clock) + 10_000_000_000)
    assert [(r.t_ns, r.frame.id) for r in got(b.receive())] == [(under_way, 0x10)]
    assert [(r.t_ns, r.frame.id) for r in got(a.receive())] == [(waiting, 0x20)]


def test_a_frame_is_filled_up_to_a_length_that_can_fd_has_each_time_it_is_sent(join):
    a, b = join(), join()
    for _ in range(3):
        assert a.send(sent_array([Frame(0x10, b"123456789", FD)])) == 1
        (received,) = got(collect(b, soon()))
        assert received.frame.data == b"123456789\0\0\0"


def test_slow_reader_loses_the_oldest_and_is_told(join):
    fast = BitTiming(1_000_000_000, 1_000_000_000)
    a, reader = join(fast), join(fast)
    total = 3 * 8192
    for k in range(0, total, 64):
        frames = [Frame((k + i) & 0x7FF, b"") for i in range(64)]
        while frames:
            frames = frames[a.send(sent_array(frames)) :]
    time.sleep(0.01)
    received = got(reader.receive())
    lost = reader.overflow
    assert 0 < lost <= total - 8192
    assert len(received) == total - lost
    assert [r.frame.id for r in received[-64:]] == [(total - 64 + i) & 0x7FF for i in range(64)]
    got(reader.receive())
    assert reader.overflow == lost


def test_a_reader_that_slept_for_longer_than_the_log_goes_on_with_the_newest(join):
    fast = BitTiming(1_000_000_000, 1_000_000_000)
    a, b, reader = join(fast), join(fast), join(fast)
    for k in range(0, 40_000, 32):
        for node in (a, b):
            frames = [Frame((k + i) & 0x7FF, b"") for i in range(32)]
            while frames:
                frames = frames[node.send(sent_array(frames)) :]
    time.sleep(0.01)
    received = got(reader.receive())
    assert 0 < len(received) <= 16384
    assert len(received) + reader.overflow == pytest.approx(80_000, rel=0.01)
    a.send(sent_array([Frame(0x123, b"now")]))
    assert got(collect(reader, soon(), {0x123}))[-1].frame.data == b"now"


def test_error_frame_goes_before_all_that_waits(join):
    a, b, c = join(CRAWL), join(CRAWL), join(CRAWL)
    a.send(sent_array([Frame(0x10, bytes(8))]))
    a.send(sent_array([Frame(0x01, b"")]))
    b.send(sent_array([Frame(0, b"", ERROR)]))
    received = got(collect(c, soon(), {0x01}))
    assert [(r.frame.id, r.frame.flags) for r in received] == [(0x10, 0), (0, ERROR), (0x01, 0)]


def test_frames_that_this_bus_cannot_carry_are_refused(join):
    node = join(BitTiming(500_000, 500_000), fd=False)
    for frame in (Frame(0x800, b""), Frame(1, bytes(9)), Frame(1, bytes(8), FD)):
        with pytest.raises(BusError):
            node.send(sent_array([frame]))
    assert node.flush_tx() == 0


def test_timing_is_fixed_by_the_first_who_states_it(join):
    viewer = join(None, None)
    join(FAST)
    assert viewer.mode.timing == FAST
    with pytest.raises(BusError, match=r"CAN FD 1000000/5000000.*asked for was CAN FD 500000/2000000"):
        join(BitTiming(500_000, 2_000_000))
    with pytest.raises(BusError, match=f"classic CAN 1000000.*{os.getpid()}"):
        join(FAST, fd=False)


def test_killed_in_full_flight_leaves_the_bus_usable(join):
    a, b = join(), join()
    for _ in range(4):
        child = start("while True: node.send([Frame(0x555, bytes(8))] * 4); node.receive()")
        assert got(collect(b, soon()))
        time.sleep(0.05)
        end(child)
        time.sleep(0.02)
        got(b.receive())
        a.send(sent_array([Frame(0x10, b"alive")]))
        assert got(collect(b, soon(1), {0x10}))[-1].frame.data == b"alive"
    # the sender has noticed the deaf sockets and the newcomer has swept them
    late = join()
    assert len(late._wire.present()) == 3


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_sender_that_is_gone_between_writing_a_frame_and_counting_it_has_no_effect(join, number):
    child = start(
        f"""
from drivers.can.localcan import layout, log
def half(words, *given):
    record = layout.record_at(node.serial, 0)
    words[record : record + layout.RECORD_WORDS] = [0, -1, 0, 1, 1000, node.serial, 0x21, *[0] * 8]
    os.kill(os.getpid(), {int(number)})
log.put = half
sys.stdin.readline(); node.send([Frame(0x21, b"never")])
""",
        stdin=subprocess.PIPE,
    )
    a, b = join(), join()
    child.stdin.write("send\n")
    child.stdin.close()
    time.sleep(0.1)
    for k in range(50):
        a.send(sent_array([Frame(0x20, k.to_bytes(1, "little"))]))
        (received,) = got(collect(b, soon(), {0x20}))
        assert received.frame.data == k.to_bytes(1, "little")
    assert a.overflow == b.overflow == 0
    end(child)


def start_by_hand(words, sender, number):
    """Put a start into the log as one who is gone before it has written the frame's end."""
    index = max(layout.FIRST, int(words[layout.HINT_AT]))
    entry = (
        index // layout.LOG << layout.LAP_SHIFT | sender.serial % layout.SLOTS << layout.NUMBER_BITS | number
    )
    words[layout.LOG_AT + index % layout.LOG] = entry


@pytest.mark.parametrize("late", [False, True])
def test_a_frame_ends_for_all_alike_although_who_started_it_is_gone_before_it_wrote_the_end(join, late):
    a, b, c = join(CRAWL), join(CRAWL), join(CRAWL, own=True)
    assert a.send(sent_array([Frame(0x20, bytes(8)), Frame(0x10, bytes(8))])) == 2
    start_by_hand(b._wire.words, a, 0)
    readers = [b, join(CRAWL), c] if late else [b, c]
    heard = [[(r.t_ns, r.frame.id) for r in got(collect(each, soon(), {0x10}))] for each in readers]
    assert heard[0] == heard[-1]
    (first, _), (second, _) = heard[0]
    assert [id_ for _, id_ in heard[0]] == [0x20, 0x10]
    assert second - first == CLASSIC_8_BYTES * 500_000
    assert heard[1][-1] == heard[0][-1]


def test_a_frame_that_is_taken_back_as_it_starts_is_on_nobodys_wire(join, monkeypatch):
    a, b, c = join(CRAWL), join(CRAWL), join(CRAWL)
    for node in (a, b, c):  # so early that nobody else starts it
        monkeypatch.setattr(node.clock, "now", lambda: 7)
    assert a.send(sent_array([Frame(0x20, bytes(8)), Frame(0x21, bytes(8))])) == 2
    assert a.flush_tx() == 2
    start_by_hand(b._wire.words, a, 0)
    assert b.send(sent_array([Frame(0x30, bytes(8))])) == 1
    monkeypatch.undo()
    heard = [[(r.t_ns, r.frame.id) for r in got(collect(each, soon(), {0x30}))] for each in (c, a)]
    assert [id_ for _, id_ in heard[0]] == [0x30]
    assert heard[0] == heard[1]
    assert a.overflow == c.overflow == 0


def test_who_joins_or_leaves_waits_for_a_stopped_one_for_a_bounded_time(join, runtime, monkeypatch):
    monkeypatch.setattr("drivers.can.localcan.wire.JOIN_S", 0.2)
    a, b = join(), join()
    with (next((runtime / "hexapod-hil").glob("t.wire*"))).open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        begun = time.monotonic()
        with pytest.raises(BusError, match=r"has held .*t\.wire\d for 0.2 s.*kill -CONT"):
            join()
        a.send(sent_array([Frame(1, b"on")]))
        assert got(collect(b, soon(), {1}))
        a.close()
        assert time.monotonic() - begun < 2.0
    join()


def test_a_reader_is_woken_although_the_one_who_rang_it_was_killed(join):
    # a rung doorbell that never sounded: the next frame after 20 ms rings again
    reader, sender = join(), join()
    reader.arm()
    reader._wire.words[slot_at(reader.serial) + SLOT_RUNG] = time.monotonic_ns()
    time.sleep(0.03)
    sender.send(sent_array([Frame(1, b"")]))
    assert select.select([reader], [], [], 1.0)[0]


def test_leftovers_of_a_dead_bus_do_not_disturb_the_next(join, runtime):
    child = start("node.send([Frame(0x111, bytes(8))] * 60); os.kill(os.getpid(), 9)")
    child.wait(10)
    end(child)
    assert list((runtime / "hexapod-hil").iterdir())
    # other timing than the dead bus had, none of its frames, and no trace at the end
    a, b = join(SLOW), join(SLOW)
    a.send(sent_array([Frame(0x10, b"new")]))
    assert [r.frame.id for r in got(collect(b, soon()))] == [0x10]
    a.close()
    b.close()
    assert list((runtime / "hexapod-hil").iterdir()) == []


def test_runtime_folder_must_be_the_owners_alone(runtime):
    folder = runtime_folder()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    folder.chmod(0o755)
    with pytest.raises(BusError, match="mode 0700"):
        Participant("t")
    folder.chmod(0o700)
    folder.rmdir()
    folder.symlink_to(tempfile.gettempdir())
    with pytest.raises(BusError, match="0700"):
        Participant("t")


def test_without_runtime_directory_a_folder_of_our_own_is_used(monkeypatch):
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    folder = runtime_folder()
    assert folder.name == f"hexapod-hil-{os.getuid()}"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@pytest.mark.realtime
def test_two_processes_at_full_load_lose_nothing_and_take_the_bus_time(join):
    node = join()
    child = start(
        """
frames = [Frame(0x100, i.to_bytes(4, "little"), 6) for i in range(4000)]
while frames:
    frames = frames[node.send(frames[:16]):]
    time.sleep(2e-4)
time.sleep(1)
"""
    )
    received: list[Received] = []
    deadline = soon(10)
    while len(received) < 4000 and time.monotonic_ns() < deadline:
        received += got(collect(node, soon(0.5)))
    end(child)
    assert [int.from_bytes(r.frame.data, "little") for r in received] == list(range(4000))
    # 34 bit + (5 + 32 + stuff 9 + 4 + 17 + 6) bit at 5 Mbit/s = 34 + 14.6 us, ISO 11898-1
    gaps = [t.t_ns - s.t_ns for s, t in itertools.pairwise(received)]
    assert min(gaps) == 48_600
    assert node.overflow == 0


def test_who_joins_beside_a_sender_stays_on_the_bus(join):
    child = start("while True: node.send([Frame(0x55, b'')]); time.sleep(2e-4)")
    node = join()
    for _ in range(60):
        late = Participant("t", FAST)
        assert got(collect(late, soon(), {0x55}))
        assert late.serial in node._wire.present()
        late.close()
    end(child)


def test_no_room_for_one_more_leaves_the_others_alone(join, monkeypatch):
    a, b = join(), join()

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(BusError, match=r"no room for \d+ KiB"):
        Participant("t", FAST)
    monkeypatch.undo()
    a.send(sent_array([Frame(1, b"on")]))
    assert got(collect(b, soon(), {1}))
    a.send(sent_array([Frame(2, b"on")]))
    assert got(collect(join(), soon(0.05))) == [] or got(b.receive())


def test_threads_may_share_a_participant(join):
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


def test_what_is_on_the_wire_cannot_be_withdrawn(join):
    a, b = join(), join()
    a.send(sent_array([Frame(0x31, b"x")]))
    time.sleep(0.005)
    assert a.flush_tx() == 0
    assert [r.frame.id for r in got(collect(b, soon(), {0x31}))] == [0x31]


@pytest.mark.long
def test_all_see_one_order_whoever_is_stopped_when(join, tmp_path):
    """Four processes send, two of them are stopped and continued at random; all logs agree."""
    watcher = join()
    code = """
import json, random
random.seed({seed}); seen = []; sys.stdin.readline(); until = time.monotonic() + 2.0
while time.monotonic() < until:
    node.send([Frame(random.randrange(0x100, 0x700), bytes([{seed}, k])) for k in range(random.randrange(3))])
    seen += node.receive()
    time.sleep(random.random() * 1e-3)
time.sleep(0.4); seen += node.receive()
with open("{folder}/{seed}", "w") as file:
    json.dump([(t, f.id, f.data.hex()) for t, f in seen], file)
print("done", flush=True)
"""
    with contextlib.ExitStack() as stack:
        children = [
            start(code.replace("{seed}", str(k)).replace("{folder}", str(tmp_path)), stdin=subprocess.PIPE)
            for k in range(4)
        ]
        for child in children:
            stack.callback(end, child)
        for child in children:
            print(file=child.stdin, flush=True)
        order = random.Random(3)
        seen, until = [], time.monotonic() + 2.0
        while time.monotonic() < until:
            child = order.choice(children[:2])
            os.kill(child.pid, signal.SIGSTOP)
            time.sleep(order.random() * 0.01)
            os.kill(child.pid, signal.SIGCONT)
            seen += got(watcher.receive())
        assert [child.stdout.readline() for child in children] == ["done\n"] * 4
    logs = [[tuple(each) for each in json.loads((tmp_path / str(k)).read_text())] for k in range(4)]
    seen += got(watcher.receive())
    ends = [t for t, _ in seen]
    assert ends == sorted(set(ends)), "one after the other"
    frames = [(t, f.id, f.data.hex()) for t, f in seen]
    assert len(frames) > 2000
    for seed, log in enumerate(logs):
        others = [each for each in frames if each[2][:2] != f"{seed:02x}"]
        begun = others.index(log[0])
        assert log == others[begun : begun + len(log)]


@pytest.mark.parametrize("seed", range(20))
def test_the_log_decides_as_arbitration_does(runtime, monkeypatch, seed):
    """Random traffic on a wire whose clock is turned by hand, against `arbitrate`."""
    chance = random.Random(seed)
    now = [1_000_000]
    nodes = [Participant("t", FAST) for _ in range(3)]
    for node in nodes:
        node.clock.begin(1, 1)

    def set_time(t_ns):
        # bench time stands where the earliest due is
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
            queued.append((now[0], priority(id_, 0), len(names), frame_time_ns(size, 0, FAST)))
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


def test_memory_that_cannot_be_mapped_is_said_with_what_to_raise_and_leaves_no_file(monkeypatch):
    def refused(*_):
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))

    monkeypatch.setattr("drivers.can.localcan.wire.mmap.mmap", refused)
    with pytest.raises(BusError, match=r"localcan: .*: Cannot allocate memory: .* MB .*raise .*`ulimit -v`"):
        Participant("unmapped", BitTiming(1_000_000, 5_000_000))
    assert not list(runtime_folder().glob("*unmapped*"))
